"""A test that flies or measures is run again where the machine was late, and never green or red for that alone."""

from __future__ import annotations

import signal
import sys
import threading
import time
from pathlib import Path

import pytest

from tests import lateness, sleeper
from tests.e2e import flying
from tests.rigs.inner_pytest import run_pytest

pytestmark = pytest.mark.timeout(600)  # a pytest within pytest takes seconds, on a busy machine minutes
TESTS = Path(__file__).parents[1]

OWN = """
import os, signal, subprocess, time
from pathlib import Path
import pytest
from tests import lateness, sleeper

sleeper.QUIET_S = 0.2
HERE = Path(__file__).parent

def late():
    '''The sleeper is stopped for a moment, as on a machine that has no time for it.'''
    watch, began_s = lateness.watching(), time.monotonic()
    while not watch.late_ms((began_s, float("inf"))):  # it may not sleep yet, or not have slept just then
        watch._process.send_signal(signal.SIGSTOP)
        time.sleep(0.2)
        watch._process.send_signal(signal.SIGCONT)
        time.sleep(0.1)

@pytest.fixture(scope="module")
def flown():
    turns = HERE / "turns"
    turns.write_text(str(int(turns.read_text()) + 1 if turns.exists() else 1))
    LATE and late()
    return int(turns.read_text())

@pytest.mark.MARK
def test_it(flown):
    FAILS
"""
CONFIGURATION = (
    '[tool.pytest.ini_options]\nmarkers = ["integration: a", "long: b", "e2e: c", "alone: d"]\ntimeout = 30\n'
)
AGAIN = "assert flown > 1"
FAR = "def test_far():\n    pass\n"
ENDS = "    assert int(turns.read_text()) > 1\n"
NOT_YET = "ExceptionGroup('one', [TimeoutError('not yet')])"


@pytest.mark.parametrize(
    ("late", "mark", "fails", "turns", "said"),
    [
        ("True", "integration", "assert False, 'what failed'", lateness.TURNS, "1 inconclusive"),
        ("True", "integration", AGAIN, 2, "1 passed"),
        ("True", "integration", "raise KeyError", 1, "1 failed"),
        ("False", "integration", "raise lateness.Void('the emulator was late')", lateness.TURNS, "1 inconclusive"),
        ("False", "integration", "if flown == 1: raise lateness.Void('the emulator was late')", 2, "1 passed"),
        ("False", "long", "raise lateness.Void('the emulator was late')", lateness.TURNS, "1 failed"),
        ("True", "long", AGAIN, 2, "1 passed"),
        ("True", "long", "assert False, 'what failed'", lateness.TURNS, "1 failed"),
        ("False", "integration", AGAIN, 1, "1 failed"),
    ],
    ids=[
        "always late",
        "late once",
        "another failure",
        "void",
        "void once",
        "void, not integration",
        "late once, not integration",
        "always late, not integration",
        "not late",
    ],
)
@pytest.mark.long
def test_a_late_machines_failure_is_no_failure(
    late: str, mark: str, fails: str, turns: int, said: str, tmp_path: Path
) -> None:
    lines = _run(OWN.replace("MARK", mark).replace("FAILS", fails), late, tmp_path)
    assert said in lines[-1], lines
    assert int((tmp_path / "turns").read_text()) == turns
    for name in ("what failed", "the emulator was late"):
        assert any(name in line for line in lines) == (name in fails and said != "1 passed")
    assert lines[-2].startswith("INCONCLUSIVE test_it.py::test_it: test_it.py:") == (said == "1 inconclusive")


@pytest.mark.long
def test_each_test_of_a_file_whose_fixture_stays_late_is_named_and_the_fixture_is_not_made_again(
    tmp_path: Path,
) -> None:
    source = (
        OWN.replace("MARK", "integration")
        .replace("FAILS", "pass")
        .replace("    return", "    assert False, 'why'\n    return")
    )
    lines = _run(source + "\n@pytest.mark.integration\ndef test_more(flown):\n    pass\n", "True", tmp_path)
    assert "2 inconclusive" in lines[-1], lines
    assert int((tmp_path / "turns").read_text()) == lateness.TURNS
    place = 1 + source.splitlines().index("    assert False, 'why'")
    for line, name in zip(lines[-3:-1], ("test_it", "test_more"), strict=True):
        why = f"test_it.py:{place}: AssertionError: why; in each of {lateness.TURNS} turns the machine was late, in the"
        assert line.startswith(f"INCONCLUSIVE test_it.py::{name}: {why}")


@pytest.mark.long
def test_a_fixture_that_was_set_up_late_for_an_earlier_test_is_made_again(tmp_path: Path) -> None:
    source = OWN.replace("MARK", "integration").replace("FAILS", "pass")
    lines = _run(f"{source}\n@pytest.mark.integration\ndef test_more(flown):\n    {AGAIN}\n", "True", tmp_path)
    assert "2 passed" in lines[-1], lines
    assert int((tmp_path / "turns").read_text()) == 2


@pytest.mark.parametrize(
    ("mark", "fails", "turns", "said"),
    [
        ("integration", AGAIN, 2, "2 passed"),
        ("integration", "assert False, 'what failed'", 2, "1 failed, 1 passed"),
        ("integration", "raise KeyError", 1, "1 failed, 1 passed"),
        ("integration", f"if flown == 1: raise ExceptionGroup('two', [{NOT_YET}])", 2, "2 passed"),
        ("integration", f"raise ExceptionGroup('two', [{NOT_YET}, KeyError()])", 1, "1 failed, 1 passed"),
        ("long", AGAIN, 1, "1 failed, 1 passed"),
    ],
    ids=["beside others alone", "by itself too", "another failure", "a group", "a mixed group", "not integration"],
)
@pytest.mark.long
def test_what_fails_beside_others_fails_by_itself_too_or_is_named(
    mark: str, fails: str, turns: int, said: str, tmp_path: Path
) -> None:
    (tmp_path / "test_other.py").write_text("def test_other():\n    pass\n")
    lines = _run(OWN.replace("MARK", mark).replace("FAILS", fails), "False", tmp_path, "--numprocesses", "2")
    assert said in lines[-1], lines
    assert int((tmp_path / "turns").read_text()) == turns
    named = [line for line in lines if line.startswith("PASSED ALONE test_it.py::test_it, beside others test_it.py:")]
    assert len(named) == (said == "2 passed")


OTHERS = """
import time
from pathlib import Path
import pytest

@pytest.mark.parametrize("n", range(9))
def test_other(n):
    with (Path(__file__).parent / "others").open("a") as file:
        print(time.monotonic_ns(), file=file)
"""
IS_LAST = f"{AGAIN}; import time; (HERE / 'again').write_text(str(time.monotonic_ns()))"


@pytest.mark.long
def test_what_runs_again_holds_nobody_up(tmp_path: Path) -> None:
    for name in "abcd":
        (tmp_path / f"test_{name}.py").write_text(OTHERS)
    lines = _run(OWN.replace("MARK", "integration").replace("FAILS", IS_LAST), "True", tmp_path, "--numprocesses", "1")
    assert "37 passed, 1 again" in lines[-1], lines
    others = [int(line) for line in (tmp_path / "others").read_text().splitlines()]
    assert max(others) < int((tmp_path / "again").read_text())


@pytest.mark.long
def test_the_tests_of_a_flight_that_is_flown_again_wait_for_it(tmp_path: Path) -> None:
    source = OWN.replace("MARK", "e2e").replace("FAILS", "pass")
    source = source.replace("    return", f"    flown = int(turns.read_text())\n    {AGAIN}\n    return")
    source += "\n@pytest.mark.e2e\ndef test_more(flown):\n    assert flown == 2\n"
    lines = _run(source, "True", tmp_path, "--numprocesses", "1")
    assert "2 passed, 2 again" in lines[-1], lines
    assert int((tmp_path / "turns").read_text()) == 2


@pytest.mark.long
def test_what_comes_behind_a_test_that_waits_for_its_flight_finds_nothing_of_the_one_before(tmp_path: Path) -> None:
    """Flights that are alone come last, so another file's are between those of one file."""
    for name, test in (("other/test_it", FAR), ("flights/test_other", f"@pytest.mark.e2e\n{FAR}")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.py").write_text(f"import pytest\n\n{test}")
    source = OWN.replace("MARK", "e2e").replace("FAILS", "pass")
    source = source.replace("    return", f"    flown = int(turns.read_text())\n    {AGAIN}\n    return")
    source += "\n@pytest.mark.e2e\n@pytest.mark.alone\ndef test_more(flown):\n    assert flown == 2\n"
    lines = _run(source, "True", tmp_path, "--numprocesses", "1", at="flights/test_it_flies.py")
    assert "4 passed, 2 again" in lines[-1], lines


@pytest.mark.long
def test_a_fixture_that_ends_badly_on_a_late_machine_is_made_again_too(tmp_path: Path) -> None:
    source = OWN.replace("MARK", "integration").replace("FAILS", AGAIN)
    source = source.replace("    return", "    yield").replace("@pytest.mark", f"{ENDS}\n@pytest.mark")
    source += "\n@pytest.mark.integration\ndef test_more(flown):\n    pass\n"
    lines = _run(source, "True", tmp_path)
    assert "2 passed" in lines[-1], lines


@pytest.mark.long
def test_what_was_to_run_again_and_could_not_has_not_passed(tmp_path: Path) -> None:
    fails = "if flown > 1: os.kill(os.getpid(), signal.SIGKILL)\n    assert False"
    (tmp_path / "test_other.py").write_text("def test_other():\n    pass\n")
    source = OWN.replace("MARK", "integration").replace("FAILS", fails)
    lines = _run(source, "True", tmp_path, "--numprocesses", "2", code=1)
    assert "NOT RUN AGAIN test_it.py::test_it: its worker ended" in lines, lines


SAYS = """
from tests import lateness

def test_it(request):
    lateness.passes_alone(request.node, "a rule")
"""


@pytest.mark.long
def test_what_a_fixture_did_again_by_itself_is_said_too(tmp_path: Path) -> None:
    assert "PASSED ALONE test_it.py::test_it, beside others a rule" in _run(SAYS, "False", tmp_path)


def _run(
    source: str, late: str, folder: Path, *options: str, code: int | None = None, at: str = "test_it.py"
) -> list[str]:
    """The lines of a run, with this exit code, of tests whose fixture finds the machine late or not."""
    (folder / "tests").mkdir()
    (folder / "conftest.py").write_text((TESTS / "conftest.py").read_text())
    for name in ("__init__.py", "workers.py", "lateness.py", "sleeper.py", "soak.py"):
        (folder / "tests" / name).write_text((TESTS / name).read_text())
    (folder / "pyproject.toml").write_text(CONFIGURATION)
    (folder / at).write_text(source.replace("LATE and", f"{late} and"))
    if late == "False":  # nor may it be late by the load of this machine
        sleeper_py = folder / "tests" / "sleeper.py"
        sleeper_py.write_text(sleeper_py.read_text().replace(f"LATE_MS = {sleeper.LATE_MS}", "LATE_MS = 10**9"))
    done = run_pytest(folder, *options)
    assert code in (None, done.returncode), done.stdout
    return [line for line in done.stdout.splitlines() if line]


LATE = "the emulator did not keep up: 12.8 ms late at p99; expected 10 at most"
WITH_IT = "mavlink was void in the same attempt"


@pytest.mark.parametrize(
    ("mqttxt", "mavlink", "reason"),
    [
        ((1, []), (1, []), None),
        ((1, []), (1, [LATE, LATE]), None),
        ((0, [WITH_IT]), (0, [LATE]), f"mavlink: {LATE}"),
        ((1, []), (0, [LATE]), f"mavlink: {LATE}"),
        ((0, ["no capture at gs"]), (0, ["mqttxt was void in the same attempt"]), None),
    ],
)
def test_a_run_is_void_where_the_machine_let_no_attempt_of_a_side_count(
    mqttxt: tuple[int, list[str]], mavlink: tuple[int, list[str]], reason: str | None
) -> None:
    protocols = {
        name: {"attempts": [{}] * counted, "void": [{"reason": one} for one in void]}
        for name, (counted, void) in {"mqttxt": mqttxt, "mavlink": mavlink}.items()
    }
    assert flying.void_reason({"protocols": protocols}) == reason


FLIES_ON = f"""#!{sys.executable}
import signal, sys
signal.signal(signal.SIGINT, lambda *_: sys.exit(130))
print(SAID, flush=True)
signal.pause()
"""


@pytest.mark.parametrize(
    ("said", "limit_s", "error"),
    [("  void: the emulator did not keep up", 30.0, flying.Void), ("  completed", 0.1, AssertionError)],
)
def test_a_run_that_will_not_say_what_is_waited_for_is_ended(
    said: str, limit_s: float, error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "testbed"
    program.write_text(FLIES_ON.replace("SAID", repr(said)))
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    run = flying.Run(tmp_path / "results")
    run.says(said)
    with pytest.raises(error, match=said.strip()):
        run.wait_for(lambda: False, limit_s)
    assert run.wait() == 130


def test_a_line_that_is_half_written_is_read_when_it_is_whole() -> None:
    watch = sleeper.Watch()
    watch._process.send_signal(signal.SIGSTOP)
    try:
        with watch._file.open("a") as file:
            file.write("8.5 9.5 40 False\n8.5 9.5")
            file.flush()
            assert watch._lines() == [["8.5", "9.5", "40", "False"]]
            file.write(" 50 False\n")
            file.flush()
            assert [line[2] for line in watch._lines()] == ["40", "50"]
    finally:
        watch._process.send_signal(signal.SIGCONT)
        watch.end()


def test_what_delays_a_test_to_its_end_may_delay_the_one_that_watches_for_longer() -> None:
    watch = sleeper.Watch()
    try:
        watch.late_ms()  # it sleeps
        watch._process.send_signal(signal.SIGSTOP)
        began_s = time.monotonic()
        threading.Timer(0.2, watch._process.send_signal, [signal.SIGCONT]).start()
        assert watch.late_ms((began_s, began_s)) > sleeper.LATE_MS
    finally:
        watch.end()
