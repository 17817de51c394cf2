"""The scenarios on a fleet that is made up: each step waits for what it asked for, and says why it failed."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from mission import scenarios, steps
from mission.events import EventLog
from mission.fleet import CommandResult, MissionError, Point, Reading, Status, Survey
from mission.points import points_of
from mission.steps import Steps
from mission.surveys import surveys_of
from mqttxt.protocol.readings import UNITS
from tests.rigs.loopback import eventually


class Fleet:
    """Two drones that do at once what they are told, unless `answers` says otherwise."""

    drones = (1, 2)
    later_s = 0.0
    """Behind a step's limit, when it is known what became of a command."""

    def __init__(self, **answers: list[CommandResult]) -> None:
        self.asked: list[Any] = []
        self.readings: list[Reading] = []
        self._answers = answers
        self._now = Status(armed=False, mode="hold", altitude_m=0.0, landed="on_ground")
        self._news = asyncio.Event()

    async def connect(self, limit_s: float) -> None: ...

    async def close(self) -> None: ...

    def within(self, limit_s: float) -> float:
        return limit_s + self.later_s

    async def arm(self) -> list[CommandResult]:
        return self._answer("arm", Status(armed=True, mode="hold", altitude_m=0.0, landed="on_ground"))

    async def takeoff(self, altitude_m: float) -> list[CommandResult]:
        self.asked.append(altitude_m)
        return self._answer("takeoff", Status(armed=True, mode="hold", altitude_m=altitude_m, landed="in_air"))

    async def goto(self, points: Mapping[int, Point]) -> list[CommandResult]:
        self.asked.append(dict(points))
        return self._answer("goto", Status(armed=True, mode="hold", altitude_m=10.0, landed="in_air"))

    async def goto_best(self, point: Point) -> CommandResult:
        self.asked.append(point)
        return self._answer("best", self._now)[0]

    async def return_home(self) -> list[CommandResult]:
        return self._answer("return", Status(armed=False, mode="return", altitude_m=0.0, landed="on_ground"))

    async def upload(self, surveys: Mapping[int, Survey]) -> list[CommandResult]:
        self.asked.append(dict(surveys))
        return self._answer("upload", self._now)

    async def fly_survey(self) -> list[CommandResult]:
        return self._answer("survey", Status(armed=False, mode="hold", altitude_m=0.0, landed="on_ground"))

    async def land(self) -> list[CommandResult]:
        return self._answer("land", Status(armed=False, mode="land", altitude_m=0.0, landed="on_ground"))

    def status(self, drone: int) -> Status:
        return self._now

    async def changed(self) -> None:
        await self._news.wait()
        self._news.clear()

    def becomes(self, status: Status) -> None:
        self._now = status
        self._news.set()

    def brings(self, drone: int, seq: int, kind: str) -> None:
        self.readings.append(Reading(drone, drone, 1, seq, kind, 0.5, UNITS[kind], 1000 * seq))
        self._news.set()

    def _answer(self, name: str, status: Status) -> list[CommandResult]:
        self.asked.append(name)
        self.becomes(status)
        return self._answers.get(name, [CommandResult(drone, "completed") for drone in self.drones])


@pytest.fixture
def log(tmp_path: Path) -> EventLog:
    return EventLog(tmp_path / "events.jsonl", StringIO())


def _events(tmp_path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]


def _done(tmp_path: Path) -> list[tuple[str, bool]]:
    return [(event["name"], event["ok"]) for event in _events(tmp_path) if event["event"] == "step_done"]


async def _until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(5):
        while not condition():
            await asyncio.sleep(0)


@pytest.fixture(autouse=True)
def _short_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "HOLD_S", 0.05)


async def test_scenario_1_goes_through_its_steps(log: EventLog, tmp_path: Path) -> None:
    fleet = Fleet()
    await scenarios.scenario_1(fleet, Steps(fleet, log))
    assert fleet.asked == ["arm", 10.0, "takeoff", "land"]
    assert _done(tmp_path) == [(name, True) for name in ("arm", "takeoff", "hold", "land", "disarmed")]


async def test_scenario_2_sends_each_drone_to_its_own_point_and_back(log: EventLog, tmp_path: Path) -> None:
    fleet = Fleet()
    await scenarios.scenario_2(fleet, Steps(fleet, log))
    assert fleet.asked == ["arm", 10.0, "takeoff", points_of((1, 2)), "goto", "return"]
    assert _done(tmp_path) == [(name, True) for name in ("arm", "takeoff", "goto", "return", "disarmed")]


async def test_scenario_3_lands_at_once(log: EventLog, tmp_path: Path) -> None:
    fleet = Fleet()
    await scenarios.scenario_3(fleet, Steps(fleet, log))
    assert fleet.asked == ["arm", 10.0, "takeoff", "land"]
    assert _done(tmp_path) == [(name, True) for name in ("arm", "takeoff", "land", "disarmed")]


async def test_scenario_5_uploads_a_survey_to_each_drone_before_it_arms(log: EventLog, tmp_path: Path) -> None:
    fleet = Fleet()
    await scenarios.scenario_5(fleet, Steps(fleet, log))
    assert fleet.asked == [surveys_of((1, 2)), "upload", "arm", "survey"]
    assert _done(tmp_path) == [(name, True) for name in ("upload", "arm", "survey", "disarmed")]


async def test_scenario_5_arms_nobody_where_an_upload_fails(log: EventLog) -> None:
    fleet = Fleet(upload=[CommandResult(1, "completed"), CommandResult(2, "failed", "mission item 7: unsupported")])
    with pytest.raises(MissionError, match=r"upload: drone 2: failed \(mission item 7: unsupported\)"):
        await scenarios.scenario_5(fleet, Steps(fleet, log))
    assert "arm" not in fleet.asked


async def test_scenario_4_returns_when_every_series_is_there(log: EventLog, tmp_path: Path) -> None:
    fleet = Fleet()
    flying = asyncio.create_task(scenarios.scenario_4(fleet, Steps(fleet, log, samples=2)))
    wanted = [(drone, seq, kind) for drone in fleet.drones for seq in range(2) for kind in UNITS]
    for drone, seq, kind in wanted[:-1]:
        fleet.brings(drone, seq, kind)
    await _until(lambda: "collect" in (tmp_path / "events.jsonl").read_text())
    assert "return" not in fleet.asked, "one value is not there yet"
    fleet.brings(*wanted[-1])
    async with asyncio.timeout(5):
        await flying
    assert fleet.asked[-1] == "return"
    assert _done(tmp_path) == [(name, True) for name in ("arm", "takeoff", "goto", "collect", "return", "disarmed")]


async def test_a_sensor_that_never_comes_into_range_is_named(log: EventLog, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "COLLECT_SPARE_S", -1.95)
    fleet = Fleet()
    for kind in UNITS:
        fleet.brings(1, 0, kind)
        fleet.brings(1, 1, kind)
    fleet.brings(2, 0, "humidity")
    fleet.brings(2, 1, "humidity")
    with pytest.raises(MissionError) as failure:
        await Steps(fleet, log, samples=2).collect()
    assert str(failure.value) == "collect: not done within 0.05 s (drone 2: 0 temperature, 0 light of 2 each)"


async def test_a_drone_of_whose_sensor_nothing_came_is_named_with_it(
    log: EventLog, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steps, "COLLECT_SPARE_S", -0.95)
    fleet = Fleet()
    fleet.brings(1, 0, "light")
    with pytest.raises(MissionError) as failure:
        await Steps(fleet, log, samples=1, was_reached=lambda drone: drone == 1).collect()
    assert str(failure.value) == (
        "collect: not done within 0.05 s (drone 1: 0 temperature, 0 humidity of 1 each; "
        "drone 2: its sensor 2 was never in range)"
    )
    with pytest.raises(MissionError, match=r"drone 2: its sensor 2 sent nothing that arrived\)$"):
        await Steps(fleet, log, samples=1).collect()


async def test_the_drone_that_went_is_told_and_one_that_did_not_arrive_fails_the_step(log: EventLog) -> None:
    point = Point(47.0, 8.0, 10.0)
    fleet = Fleet(best=[CommandResult(2, "completed")])
    assert await Steps(fleet, log).goto_best(point, limit_s=5) == 2
    assert fleet.asked == [point, "best"]
    with pytest.raises(MissionError, match=r"^goto: drone 1: failed \(mode_changed\)$"):
        await Steps(Fleet(best=[CommandResult(1, "failed", "mode_changed")]), log).goto_best(point, limit_s=5)


async def test_a_drone_that_does_not_arrive_fails_scenario_2(log: EventLog) -> None:
    fleet = Fleet(goto=[CommandResult(1, "completed"), CommandResult(2, "failed", "mode_changed")])
    with pytest.raises(MissionError, match=r"^goto: drone 2: failed \(mode_changed\)$"):
        await scenarios.scenario_2(fleet, Steps(fleet, log))
    assert "return" not in fleet.asked


@pytest.mark.parametrize(
    ("answers", "reason"),
    [
        (
            {"arm": [CommandResult(1, "completed"), CommandResult(2, "denied", "autopilot")]},
            "arm: drone 2: denied (autopilot)",
        ),
        ({"takeoff": [CommandResult(1, "completed")]}, "takeoff: drone 2: no answer"),
        (
            {"land": [CommandResult(1, "unconfirmed"), CommandResult(2, "failed", "timeout")]},
            "land: drone 1: unconfirmed; drone 2: failed (timeout)",
        ),
    ],
)
async def test_a_drone_that_does_not_complete_fails_the_mission_by_name(
    answers: dict[str, list[CommandResult]], reason: str, log: EventLog, tmp_path: Path
) -> None:
    fleet = Fleet(**answers)
    with pytest.raises(MissionError) as failure:
        await scenarios.scenario_1(fleet, Steps(fleet, log))
    assert str(failure.value) == reason
    assert _events(tmp_path)[-1] == {
        **{"t_ns": _events(tmp_path)[-1]["t_ns"], "event": "step_done", "name": reason.split(":")[0]},
        **{"ok": False, "reason": reason},
    }


async def test_a_step_that_takes_too_long_says_where_each_drone_is(log: EventLog) -> None:
    fleet = Fleet()

    async def forever() -> list[CommandResult]:
        await asyncio.Event().wait()
        return []

    asking: Callable[[], Awaitable[list[CommandResult]]] = forever
    with pytest.raises(MissionError, match=r"arm: not done within 0\.05 s \(drone 1: disarmed, on the ground, hold; "):
        await Steps(fleet, log).command("arm", asking, limit_s=0.05)


async def test_a_step_waits_for_the_word_that_tells_what_became_of_its_command(log: EventLog) -> None:
    fleet = Fleet()
    fleet.later_s = 30.0

    async def unconfirmed() -> list[CommandResult]:
        await asyncio.sleep(0.05)
        return [CommandResult(1, "completed"), CommandResult(2, "unconfirmed")]

    with pytest.raises(MissionError, match=r"^land: drone 2: unconfirmed$"):
        await Steps(fleet, log).command("land", unconfirmed, limit_s=0.01)


async def test_a_drone_that_disarms_while_holding_fails_it(log: EventLog) -> None:
    fleet = Fleet()
    fleet.becomes(Status(armed=True, altitude_m=10.0))
    holding = asyncio.create_task(Steps(fleet, log).hold(30))
    await asyncio.sleep(0)
    fleet.becomes(Status(armed=False, altitude_m=10.0))
    with pytest.raises(MissionError, match="hold: drone 1 is disarmed"):
        await holding


async def test_what_a_fleet_says_while_a_step_waits_is_that_steps_reason(log: EventLog, tmp_path: Path) -> None:
    class Lost(Fleet):
        async def changed(self) -> None:
            raise MissionError("drone 2: heartbeats stopped")

    fleet = Lost()
    fleet.becomes(Status(armed=True, altitude_m=10.0))
    with pytest.raises(MissionError, match=r"^hold: drone 2: heartbeats stopped$"):
        await Steps(fleet, log).hold(30)
    assert _events(tmp_path)[-1]["reason"] == "hold: drone 2: heartbeats stopped"


async def test_progress_is_lines_for_programs_written_when_no_command_is_under_way() -> None:
    shown = StringIO()
    log = EventLog(Path("/dev/null"), shown)
    log.show("hold", {1: "armed, 10.0 m"})
    log.show("land", {1: "armed, 3.0 m"})
    await asyncio.sleep(0)
    assert shown.getvalue() == "", "whoever reads it would take a core from the step's command"
    await eventually(shown.getvalue, "the lines")
    hold, land = map(json.loads, shown.getvalue().splitlines())
    assert hold.pop("at_s") <= land.pop("at_s")
    assert hold == {"step": "hold", "drones": {"1": "armed, 10.0 m"}}
    assert land == {"step": "land", "drones": {"1": "armed, 3.0 m"}}


async def test_progress_that_was_not_written_yet_is_at_the_end() -> None:
    shown = StringIO()
    log = EventLog(Path("/dev/null"), shown)
    log.show("land", {1: "armed, 3.0 m"})
    log.close()
    assert json.loads(shown.getvalue())["step"] == "land"


@pytest.mark.parametrize(
    ("status", "shown"),
    [
        (Status(), "silent"),
        (Status(armed=True, mode="hold", altitude_m=9.64, landed="in_air"), "armed, 9.6 m, hold"),
        (Status(armed=False, mode="land", altitude_m=0.1, landed="on_ground"), "disarmed, on the ground, land"),
    ],
)
def test_a_status_in_words(status: Status, shown: str) -> None:
    assert str(status) == shown
