"""How `make test` shares out tests: files and flights stay on one worker, and what is to be alone is."""

from __future__ import annotations

import fcntl
import json
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

from tests import workers
from tests.rigs.inner_pytest import run_pytest

pytestmark = pytest.mark.timeout(600)  # a pytest within pytest takes seconds, on a busy machine minutes
OWN = ("__init__.py", "workers.py", "lateness.py", "sleeper.py", "soak.py")
TESTS_OWN = [Path(__file__).parents[1] / name for name in OWN]
ORDERED = "--no-loadscope-reorder"
LIMIT_S = 300
TESTS = """
import json, os, time
from pathlib import Path
import pytest
from tests import lateness

pytestmark = [MARKS]

@pytest.mark.parametrize("n", range(4))
def test_some(n):
    began_ns = time.monotonic_ns()
    sum(range(LOAD))
    worker, nice = os.environ["PYTEST_XDIST_WORKER"], os.getpriority(os.PRIO_PROCESS, 0)
    sleepers_nice = os.getpriority(os.PRIO_PROCESS, lateness.watching()._process.pid)
    ran = [Path(__file__).stem, worker, nice, sleepers_nice, began_ns, time.monotonic_ns()]
    with (Path(__file__).parent / "log").open("a") as log:
        log.write(json.dumps(ran) + chr(10))
"""
HANGS = """
import signal, time
import pytest

pytestmark = [pytest.mark.integration, pytest.mark.timeout(1)]

def test_it():
    signal.signal(signal.SIGALRM, signal.SIG_IGN)
    time.sleep(200)
"""
ENDS = """
import os, signal

def test_it():
    os.kill(os.getpid(), signal.SIGKILL)

def test_one():
    pass

def test_two():
    pass
"""
FILES = {
    **{f"test_{name}": () for name in "abcd"},
    **{f"test_{name}": ("integration",) for name in "ij"},
    **{"test_k": ("integration", "apart"), "test_l": ("integration", "apart", "timeout(300)")},
    **{"test_x": ("alone",), "test_y": ("e2e",), "test_z": ("e2e", "alone")},
}


class Ran(NamedTuple):
    file: str
    worker: str
    nice: int
    sleepers_nice: int
    began_ns: int
    ended_ns: int

    @property
    def marks(self) -> tuple[str, ...]:
        return FILES[self.file]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> list[Ran]:
    return run(tmp_path_factory.mktemp("tests"), FILES)


def write(folder: Path, files: dict[str, tuple[str, ...]]) -> None:
    """Write such files, of four tests each."""
    (folder / "tests").mkdir()
    (folder / "conftest.py").write_text((Path(__file__).parents[1] / "conftest.py").read_text())
    for own in TESTS_OWN:
        (folder / "tests" / own.name).write_text(own.read_text())
    marks = [f"{mark}: a" for mark in ("alone", "e2e", "integration", "apart")]
    (folder / "pyproject.toml").write_text(f"[tool.pytest.ini_options]\nmarkers = {json.dumps(marks)}\n")
    for name, own_marks in files.items():
        named = ", ".join(f"pytest.mark.{mark}" for mark in own_marks)
        load = 5_000_000 if "integration" in own_marks else 1_000_000
        (folder / f"{name}.py").write_text(TESTS.replace("MARKS", named).replace("LOAD", str(load)))


def run(folder: Path, files: dict[str, tuple[str, ...]], workers: int = 3, *options: str) -> list[Ran]:
    """What ran of such files, four tests each unless options choose."""
    write(folder, files)
    return run_there(folder, files, workers, *options)


def run_there(folder: Path, files: dict[str, tuple[str, ...]], workers: int, *options: str) -> list[Ran]:
    """The same for files that are written."""
    done = run_pytest(folder, ORDERED, "--numprocesses", str(workers), *options, timeout_s=LIMIT_S)
    assert done.returncode == 0, done.stdout
    found = [Ran(*json.loads(line)) for line in (folder / "log").read_text().splitlines()]
    assert options or len(found) == 4 * len(files)
    return found


@pytest.mark.long
def test_a_test_that_no_time_limit_ends_costs_its_worker_and_holds_nobody_up(tmp_path: Path) -> None:
    with pytest.raises(AssertionError):
        run(tmp_path, {"test_x": ("alone",), "test_i": ("integration",)}, 2, "-k", "nothing")
    (tmp_path / "test_j.py").write_text(HANGS)
    done = run_pytest(tmp_path, ORDERED, "--numprocesses", "2", timeout_s=LIMIT_S)
    lines = done.stdout.splitlines()
    (named,) = [n for n, line in enumerate(lines) if "test_j.py::test_it failed: worker" in line]
    assert named < lines.index(next(line for line in lines if "short test summary" in line))
    assert "8 passed" in lines[-1], done.stdout
    assert "in test_it" in done.stderr


@pytest.mark.long
def test_what_was_left_to_a_worker_that_a_test_ended_is_run_by_another(tmp_path: Path) -> None:
    """Its files that were done are not handed out with it."""
    write(tmp_path, {"test_a": (), "test_b": ()})
    (tmp_path / "test_c.py").write_text(ENDS)
    done = run_pytest(tmp_path, ORDERED, "--numprocesses", "1", timeout_s=LIMIT_S)
    assert "1 failed, 10 passed" in done.stdout.splitlines()[-1], done.stdout


@pytest.mark.long
@pytest.mark.parametrize(("workers", "options"), [(1, ()), (2, ("-k", "0"))], ids=["one worker", "one test a file"])
def test_what_is_alone_does_not_wait_for_what_comes_behind_it(
    tmp_path: Path, workers: int, options: tuple[str, ...]
) -> None:
    files = {name: FILES[name] for name in ("test_x", "test_i", "test_j", "test_a")}
    assert {one.file for one in run(tmp_path, files, workers, *options)} == set(files)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "held"),
    [("test_a", fcntl.LOCK_EX), ("test_i", fcntl.LOCK_SH)],
    ids=["its flights", "its integration tests"],
)
def test_another_run_holds_up_only_what_cannot_be_beside(tmp_path: Path, name: str, held: int) -> None:
    files = {name: FILES[name]}
    write(tmp_path, files)
    with (tmp_path / "tests" / "workers.py").open() as room:
        fcntl.flock(room, held)
        assert len(run_there(tmp_path, files, 2)) == 4


@pytest.mark.long
def test_a_file_is_on_one_worker_and_all_that_flies_or_is_alone_on_one_too(ran: list[Ran]) -> None:
    workers = {name: {one.worker for one in ran if one.file == name} for name in FILES if "apart" not in FILES[name]}
    assert {len(found) for found in workers.values()} == {1}
    assert workers["test_x"] == workers["test_y"] == workers["test_z"]


@pytest.mark.long
def test_what_flies_comes_one_after_another_and_what_is_alone_when_no_integration_is_left(ran: list[Ran]) -> None:
    flights = sorted((one for one in ran if {"alone", "e2e"} & set(one.marks)), key=lambda one: one.began_ns)
    assert all(after.began_ns >= before.ended_ns for before, after in pairwise(flights))
    assert [one.file for one in flights] == ["test_y"] * 4 + ["test_x"] * 4 + ["test_z"] * 4
    integration = [one for one in ran if "integration" in one.marks]
    assert next(one for one in flights if one.file == "test_y").began_ns < max(one.ended_ns for one in integration)
    alone = next(one for one in flights if one.file == "test_x")
    assert all(one.ended_ns <= alone.began_ns for one in integration)


def test_files_with_a_browser_are_not_all_at_once() -> None:
    assert "".join(workers.mixed(["A", "BBB", "CC"], "uvwxyz123")) == "BBBuvCCwxAyz123"
    assert workers.mixed([], "uv") == ["u", "v"]
    assert workers.mixed(["A"], "") == ["A"]


@pytest.mark.long
def test_of_what_is_shared_out_the_longest_comes_first(ran: list[Ran]) -> None:
    began_ns = {name: [one.began_ns for one in ran if one.file == name] for name in ("test_k", "test_l")}
    assert min(began_ns["test_l"]) < min(began_ns["test_k"])


@pytest.mark.long
def test_what_does_not_fly_gives_way_and_what_needs_nothing_but_time_most(ran: list[Ran]) -> None:
    own = min(one.nice for one in ran)
    for one in ran:
        if {"alone", "e2e"} & set(one.marks):
            assert one.nice == own
        else:
            assert one.nice >= max(own, 5 if "integration" in one.marks else 10)


@pytest.mark.long
def test_what_watches_for_lateness_gives_way_as_its_tests_do(ran: list[Ran]) -> None:
    assert [one.sleepers_nice for one in ran] == [one.nice for one in ran]
