"""Setting up over MQTT-XT: which states come how, with a ground station that is made up."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from io import StringIO
from pathlib import Path
from typing import Any, Self

import pytest

from mission import mqttxt_fleet
from mission.events import EventLog
from mission.fleet import MissionError
from mission.mqttxt_fleet import NEEDED_STATES, MqttxtFleet
from mqttxt import Command, Outcome, Stream, Word
from mqttxt.messages import CommandId

FOGS = {1: (1, 2), 2: (4,)}


class Drone:
    is_reachable = True
    states = dict.fromkeys(NEEDED_STATES)


class Fog:
    """A fog whose drones do what they are told, unless `answers` has another word for one, or None for silence."""

    def __init__(self, number: int, asked: list[Any], answers: dict[int, Word | None]) -> None:
        self.number = number
        self._asked = asked
        self._answers = answers

    def drone(self, number: int) -> Drone:
        return Drone()

    async def broadcast(self, command: Command) -> AsyncIterator[Outcome]:
        self._asked.append((self.number, command))
        for drone in FOGS[self.number]:
            word = self._answers.get(drone, Word.COMPLETED)
            if word is not None:
                yield Outcome(CommandId(1, 1), self.number, drone, "stream", Word.ACCEPTED)
                reason = None if word is Word.COMPLETED else "unknown_state"
                yield Outcome(CommandId(1, 1), self.number, drone, "stream", word, reason)


class Station:
    """What stands in for mqttxt.GroundStation."""

    def __init__(self, answers: dict[int, Word | None]) -> None:
        self.asked: list[Any] = []
        self.options: dict[str, Any] = {}
        self._answers = answers

    def __call__(self, url: str, **options: Any) -> Self:
        self.options = options
        return self

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None: ...

    async def connect(self, fogs: dict[int, Any], limit_s: float) -> list[Fog]:
        return [Fog(number, self.asked, self._answers) for number in fogs]

    async def wait_until(self, condition: Callable[[], bool], limit_s: float) -> None:
        assert condition()

    async def events(self) -> AsyncIterator[Any]:
        await asyncio.Event().wait()
        yield


async def _set_up(
    monkeypatch: pytest.MonkeyPatch, states: str, answers: dict[int, Word | None] | None = None
) -> Station:
    station = Station(answers or {})
    monkeypatch.setattr(mqttxt_fleet, "GroundStation", station)
    fleet = MqttxtFleet("mqtt://cloud", FOGS, 0, EventLog(Path("/dev/null"), StringIO()), states)
    try:
        await fleet.connect(5)
    finally:
        await fleet.close()
    return station


async def test_on_change_asks_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    station = await _set_up(monkeypatch, "on-change")
    assert station.asked == []
    assert station.options == {"qos": 0, "bundles": False}


@pytest.mark.parametrize(("states", "bundles"), [("fixed", False), ("bundle", True)])
async def test_five_states_are_asked_for_once_a_second_at_each_fog(
    states: str, bundles: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    station = await _set_up(monkeypatch, states)
    names = ("battery", "location", "groundspeed", "flight_mode", "heading")
    assert station.asked == [(fog, Stream(name, 1.0)) for fog in FOGS for name in names]
    assert station.options["bundles"] is bundles


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (Word.DENIED, "connect: stream battery: drone 4: denied (unknown_state)"),
        (None, "connect: stream battery: drone 4: no answer"),
    ],
)
async def test_a_state_that_will_not_come_fails_the_mission_before_it_begins(
    answer: Word | None, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(MissionError) as failure:
        await _set_up(monkeypatch, "fixed", {4: answer})
    assert str(failure.value) == reason
