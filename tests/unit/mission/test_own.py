"""A mission of one's own, from a file: it flies, and whatever is wrong with it is one line with its place."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from mission.events import EventLog
from mission.fleet import MissionError
from mission.own import load, mission_of
from mission.scenarios import scenario_2
from mission.steps import Steps


class Fleet:
    """One drone of which nothing is ever heard."""

    drones = (1,)

    def __init__(self) -> None:
        self.asked: list[str] = []

    def status(self, drone: int) -> str:
        return "silent"


def _file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(text)
    return path


async def _fly(path: Path, tmp_path: Path) -> Any:
    fleet: Any = Fleet()
    await load(path)(fleet, Steps(fleet, EventLog(tmp_path / "events.jsonl", StringIO())))
    return fleet


async def test_a_file_flies(tmp_path: Path) -> None:
    path = _file(tmp_path, "async def mission(fleet, steps):\n    fleet.asked.append('flown')\n")
    assert (await _fly(path, tmp_path)).asked == ["flown"]
    assert mission_of("scenario-2") is scenario_2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("async def mission(fleet, steps)\n", "line 1: expected ':'"),
        ("x = 1\n", "expected `async def mission(fleet, steps)`"),
        ("def mission(fleet, steps): ...\n", "expected `async def mission(fleet, steps)`"),
        ("async def mission(fleet): ...\n", "expected `async def mission(fleet, steps)`"),
        ("a = 1\nb = a / 0\n", "line 2: ZeroDivisionError: division by zero"),
        ("raise SystemExit\n", "line 1: SystemExit"),
        ("x = '\0'\n", "null bytes"),
    ],
)
def test_a_file_without_a_mission_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ValueError) as error:  # noqa: PT011 - the text is looked at below
        load(_file(tmp_path, text))
    assert said in str(error.value)
    assert str(error.value).startswith("mine.py")
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.py: No such file"):
        load(tmp_path / "none.py")


async def test_what_a_mission_raises_fails_it_with_its_line(tmp_path: Path) -> None:
    path = _file(tmp_path, "async def mission(fleet, steps):\n    there = []\n    there[3]\n")
    with pytest.raises(MissionError, match=r"mine\.py, line 3: IndexError: list index out of range$"):
        await _fly(path, tmp_path)


async def test_the_whole_traceback_is_left_for_the_log(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = _file(tmp_path, "def deep():\n    return {}['far']\n\nasync def mission(fleet, steps):\n    deep()\n")
    with pytest.raises(MissionError, match=r"^mine\.py, line 2: KeyError: 'far'$"):
        await _fly(path, tmp_path)
    said = capfd.readouterr().err
    assert said.startswith("Traceback")
    assert "line 5, in mission" in said
    assert "line 2, in deep" in said


async def test_a_mission_that_ends_its_process_fails_like_any_other(tmp_path: Path) -> None:
    path = _file(tmp_path, "import sys\nasync def mission(fleet, steps):\n    sys.exit(0)\n")
    with pytest.raises(MissionError, match=r"^mine\.py, line 3: SystemExit: 0$"):
        await _fly(path, tmp_path)


async def test_of_what_is_raised_together_the_first_is_named(tmp_path: Path) -> None:
    text = """
import asyncio
async def one():
    raise ValueError("too far")
async def mission(fleet, steps):
    async with asyncio.TaskGroup() as group:
        group.create_task(one())
"""
    with pytest.raises(MissionError, match=r"^mine\.py, line 4: ValueError: too far$"):
        await _fly(_file(tmp_path, text), tmp_path)


async def test_a_mission_is_compiled_as_it_stands(tmp_path: Path) -> None:
    text = "def told(x: int): ...\nasync def mission(fleet, steps):\n    assert told.__annotations__['x'] is int\n"
    await _fly(_file(tmp_path, text), tmp_path)


async def test_a_step_that_fails_keeps_its_own_reason(tmp_path: Path) -> None:
    text = "async def mission(fleet, steps):\n    await steps.until('never', lambda drone: 1 / 0, 5)\n"
    with pytest.raises(MissionError, match=r"line 2: ZeroDivisionError"):
        await _fly(_file(tmp_path, text), tmp_path)
