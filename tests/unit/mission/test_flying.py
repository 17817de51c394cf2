"""A mission from its start to its end: when the clock of the links begins, and what is left when it fails."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from mission import flight
from mission.events import EventLog
from mission.fleet import CommandResult, MissionError, Reading, Status
from mission.options import Options
from mission.scenarios import scenario_1


class Fleet:
    """One drone; what is there of a file is noted when it is connected and when it is armed."""

    drones = (1,)
    readings: tuple[Reading, ...] = ()

    def __init__(self, watched: Path, connects: bool = True) -> None:
        self.seen: list[tuple[str, bool]] = []
        self._watched = watched
        self._connects = connects

    async def connect(self, limit_s: float) -> None:
        self.seen.append(("connect", self._watched.exists()))
        if not self._connects:
            raise MissionError("connect: drone 1 never appeared")

    async def close(self) -> None: ...

    async def arm(self) -> list[CommandResult]:
        self.seen.append(("arm", self._watched.exists()))
        return [CommandResult(1, "denied", "autopilot")]

    def status(self, drone: int) -> Status:
        return Status()

    async def changed(self) -> None: ...

    def within(self, limit_s: float) -> float:
        return limit_s

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"{name}: the mission ends with the refused arming")


async def _fly(tmp_path: Path, fleet: Fleet, **options: Any) -> tuple[str | None, list[dict[str, Any]]]:
    log = EventLog(tmp_path / "events.jsonl", StringIO())
    flown = Options("scenario-1", "mqttxt", {1: (1,)}, "", "1", "on-change", (), "px4-onboard", "one-by-one", **options)
    reason = await flight.fly(flown, scenario_1, fleet, log)  # type: ignore[arg-type]
    log.close()
    return reason, [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]


async def test_the_clock_of_the_links_begins_with_the_mission(tmp_path: Path) -> None:
    start = tmp_path / "start"
    fleet = Fleet(start)
    reason, events = await _fly(tmp_path, fleet, links_start=start)
    assert reason == "arm: drone 1: denied (autopilot)"
    assert fleet.seen == [("connect", False), ("arm", True)]
    assert start.read_bytes() == b""
    assert [event["event"] for event in events[:2]] == ["mission_start", "step"]


@pytest.mark.parametrize("asked", [True, False])
async def test_a_mission_that_does_not_begin_starts_no_clock(tmp_path: Path, asked: bool) -> None:
    start = tmp_path / "start"
    reason, events = await _fly(tmp_path, Fleet(start, connects=False), links_start=start if asked else None)
    assert reason == "connect: drone 1 never appeared"
    assert not start.exists()
    assert [event["event"] for event in events] == ["mission_end"]


async def test_what_arrived_is_held_to_what_the_sensors_wrote_down_even_if_the_mission_failed(tmp_path: Path) -> None:
    fleet = Fleet(tmp_path / "none")
    reading = Reading(1, 1, 7, 0, "light", 3.0, "lx", 5000)
    fleet.readings = (reading,)
    written = {"event": "reading", "sensor": 1, "boot": 7, "seq": 0, "kind": "light", "value": 3.0, "unit": "lx"}
    (tmp_path / "sensor1.jsonl").write_text(json.dumps(written | {"time_ms": 5000}) + "\n")
    told = tmp_path / "series.json"
    reason, events = await _fly(tmp_path, fleet, samples=1, sensors=tmp_path, series=told)
    assert reason == "arm: drone 1: denied (autopilot)", "the first thing that went wrong"
    rows = json.loads(told.read_text())["series"]
    assert {row["kind"]: row["whole"] for row in rows} == {"temperature": False, "humidity": False, "light": True}
    assert [event["kind"] for event in events if event["event"] == "series"] == ["temperature", "humidity", "light"]
