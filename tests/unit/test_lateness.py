"""A test that flies or measures is run again where the machine was late, and never green or red for that alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests import lateness

TESTS = Path(__file__).parents[1]

OWN = """
import os, signal, subprocess, time
from pathlib import Path
import pytest
import lateness

lateness.QUIET_S = 0.2
HERE = Path(__file__).parent

def late():
    '''The sleeper is stopped for a moment, as on a machine that has no time for it.'''
    process = lateness._watching()._process
    time.sleep(0.3)
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.2)
    process.send_signal(signal.SIGCONT)
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
CONFIGURATION = '[tool.pytest.ini_options]\nmarkers = ["timed: a", "long: b"]\ntimeout = 30\n'
AGAIN = "assert flown > 1"


@pytest.mark.parametrize(
    ("late", "mark", "fails", "turns", "said"),
    [
        ("True", "timed", "assert False, 'what failed'", lateness.TURNS, "1 inconclusive"),
        ("True", "timed", AGAIN, 2, "1 passed"),
        ("True", "timed", "raise KeyError", 1, "1 failed"),
        ("True", "long", AGAIN, 1, "1 failed"),
        ("False", "timed", AGAIN, 1, "1 failed"),
    ],
    ids=["always late", "late once", "another failure", "not timed", "not late"],
)
@pytest.mark.long
def test_a_late_machines_failure_is_no_failure(
    late: str, mark: str, fails: str, turns: int, said: str, tmp_path: Path
) -> None:
    for name in ("conftest.py", "lateness.py"):
        (tmp_path / name).write_text((TESTS / name).read_text())
    (tmp_path / "pyproject.toml").write_text(CONFIGURATION)
    (tmp_path / "test_it.py").write_text(
        OWN.replace("LATE and", f"{late} and").replace("MARK", mark).replace("FAILS", fails)
    )
    if late == "False":  # nor may it be late by the load of this machine
        source = (tmp_path / "lateness.py").read_text()
        (tmp_path / "lateness.py").write_text(source.replace(f"LATE_MS = {lateness.LATE_MS}", "LATE_MS = 10**9"))
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert said in done.stdout.splitlines()[-1], done.stdout
    assert int((tmp_path / "turns").read_text()) == turns
    assert ("what failed" in done.stdout) == ("what failed" in fails)
    assert ("its load is" in done.stdout) == (said == "1 inconclusive")


def test_a_line_that_is_half_written_is_read_when_it_is_whole() -> None:
    watch = lateness.Watch()
    try:
        with watch._file.open("a") as file:
            file.write("9e9 40\n9e9")
            file.flush()
            assert watch.late_ms(8e9) == 40
            file.write(" 50\n")
            file.flush()
            assert watch.late_ms(8e9) == 50
    finally:
        watch.end()
