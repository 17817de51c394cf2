"""The program under test: how it ended is said with the last line of its stderr."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest

from mqttxt.errors import ConfigurationError
from mqttxt_conformance.subject import Subject

SAYS = "import sys; print('starting', file=sys.stderr); print('mqttxt: --drone 0: expected 1', file=sys.stderr)"


def subject(program: str, log: Path | None = None) -> Subject:
    return Subject(shlex.join([sys.executable, "-c", program.replace("{", "{{")]), {}, log)


async def run(found: Subject, **changed: str) -> int | None:
    """Start it and wait for its end; returns its exit code."""
    await found.start(**changed)
    return await found.ended()


@pytest.mark.parametrize("is_logged", [True, False])
async def test_how_it_ended_is_said_with_its_last_line(is_logged: bool, tmp_path: Path) -> None:
    log = tmp_path / "log" if is_logged else None
    if log is not None:
        log.write_text("of another run\n")
    found = subject(f"{SAYS}; sys.exit(2)", log)
    assert await run(found) == 2
    said = "it ended with exit code 2: mqttxt: --drone 0: expected 1"
    assert found.why_silent("30 s") == said
    if log is not None:
        assert log.read_text().splitlines() == ["of another run", "starting", "mqttxt: --drone 0: expected 1"]


@pytest.mark.parametrize("is_logged", [True, False])
async def test_what_an_earlier_start_said_is_not_said_again(is_logged: bool, tmp_path: Path) -> None:
    """It ends in silence where a file is, and makes that file the first time."""
    flag = tmp_path / "flag"
    program = f"import pathlib, sys; f = pathlib.Path({str(flag)!r})\nif f.exists(): sys.exit(3)\nf.touch(); {SAYS}"
    found = subject(program, tmp_path / "log" if is_logged else None)
    for said in ("exit code 0: mqttxt: --drone 0: expected 1", "exit code 3"):
        await run(found)
        assert found.ending == said


async def test_a_last_line_is_printable_and_bounded() -> None:
    found = subject(r"import sys; sys.stderr.write('\x1b[2J' + 1000 * 'x' + '\n\n')")
    await run(found)
    assert found.ending.startswith(r"exit code 0: \x1b[2Jxxx")
    assert len(found.ending) < 400


async def test_one_that_goes_on_is_waited_for() -> None:
    found = subject("import time; time.sleep(60)")
    await found.start()
    try:
        assert found.why_silent("30 s") == "30 s went by"
    finally:
        await found.kill()


async def test_a_log_may_be_no_file() -> None:
    found = subject(SAYS, Path("/dev/null"))
    await run(found)
    assert found.ending == "exit code 0"


async def test_a_start_may_change_a_value_and_the_next_one_has_its_own_again(tmp_path: Path) -> None:
    log = tmp_path / "log"
    line = shlex.join([sys.executable, "-c", "import sys; print(sys.argv[1])"]) + " {broker}"
    found = Subject(line, {"broker": "first", "audit": "file"}, log)
    assert (found.names("broker"), found.names("audit")) == (True, False)
    await run(found, broker="other")
    await run(found)
    assert log.read_text().splitlines() == ["other", "first"]


async def test_what_is_stopped_stands_still_and_goes_on(tmp_path: Path) -> None:
    flag = tmp_path / "flag"
    found = subject(f"import pathlib, time; time.sleep(0.2); pathlib.Path({str(flag)!r}).touch()")
    await found.start()
    with found.stopped():
        assert await found.ended(0.5) is None
        assert not flag.exists()
    assert await found.ended() == 0
    assert flag.exists()


@pytest.mark.parametrize(
    "named", ["drone.x", "drone[x]", "drone!r", "drone:99999999999", "drone.__class__", "0", "", "nope"]
)
def test_braces_with_anything_but_a_name_are_one_line(named: str) -> None:
    with pytest.raises(ConfigurationError, match=r"^--run '.*': .*; expected a command line, with \{drone\}$"):
        Subject("uav {" + named + "}", {"drone": "1"})
