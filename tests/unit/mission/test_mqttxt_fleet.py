"""Setting up over MQTT-XT: which states come how, with a ground station that is made up."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable, Iterable
from io import StringIO
from pathlib import Path
from typing import Any, Self

import pytest

from mission import mqttxt_fleet
from mission.events import EventLog
from mission.fleet import CommandResult, MissionError, Point
from mission.mqttxt_fleet import NEEDED_STATES, TTL_S, MqttxtFleet
from mqttxt import (
    Arm,
    BrokerRefused,
    Command,
    Goto,
    Outcome,
    Outcomes,
    PsmiList,
    Return,
    SentCommand,
    StateUpdate,
    Stream,
    Word,
)
from mqttxt.core.settings import GRACE_MS
from mqttxt.protocol.messages import CommandId
from mqttxt.protocol.states import Fence, Mission, VitalState
from mqttxt.station.heard import Record
from mqttxt.station.outcomes import last_word

FOGS = {1: (1, 2), 2: (4,)}
HASH = bytes(range(16))


def said(words: Iterable[Any], answer: Callable[[Any], Any]) -> SentCommand[Any, Any]:
    """A command of which this was said."""
    record = Record[Any]()
    for word in words:
        record.hear(word)
    record.end()
    return SentCommand(record, answer)


class Drone:
    is_reachable = True
    states = dict.fromkeys(NEEDED_STATES)

    def __init__(self, fog: Fog, number: int) -> None:
        self._fog = fog
        self._number = number

    def send(self, command: Command, *, ttl_s: float, limit_s: float) -> SentCommand[Outcome, Outcome]:
        assert ttl_s == TTL_S
        self._fog.limits_s[command.name] = limit_s
        return said(self._fog.answer(command, (self._number,)), last_word)


class Fog:
    """A fog whose drones do what they are told, unless `answers` has another word for one, or None for silence."""

    def __init__(self, number: int, asked: list[Any], answers: dict[int, Word | None]) -> None:
        self.number = number
        self.limits_s: dict[str, float | None] = {}
        self._asked = asked
        self._answers = answers

    def drone(self, number: int) -> Drone:
        return Drone(self, number)

    def broadcast(
        self, command: Command, *, ttl_s: float | None = None, limit_s: float | None = None
    ) -> SentCommand[Outcomes, Outcome]:
        assert isinstance(command, Stream) or ttl_s == TTL_S
        self.limits_s[command.name] = limit_s
        self._asked.append((self.number, command))
        return said(self.answer(command, FOGS[self.number]), Outcomes.of)

    def answer(self, command: Command, drones: tuple[int, ...]) -> Iterable[Outcome]:
        if isinstance(command, Goto):
            self._asked.append((*drones, command))
        for drone in drones:
            word = self._answers.get(drone, Word.COMPLETED)
            if word is not None:
                yield Outcome(CommandId(1, 1), self.number, drone, command.name, Word.ACCEPTED)
                reason = None if word is Word.COMPLETED else "unknown_state"
                yield Outcome(CommandId(1, 1), self.number, drone, command.name, word, reason)


class Station:
    """What stands in for mqttxt.GroundStation."""

    def __init__(self, answers: dict[int, Word | None], heard: Iterable[StateUpdate] = ()) -> None:
        self._heard = heard
        self.asked: list[Any] = []
        self.options: dict[str, Any] = {}
        self.ends = asyncio.Event()
        self.end = BrokerRefused("cloud: another client took over")
        self._answers = answers

    def __call__(self, url: str, **options: Any) -> Self:
        self.options = options
        return self

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        if self.ends.is_set():
            raise self.end

    async def connect(self, fogs: dict[int, Any], limit_s: float) -> list[Fog]:
        return [Fog(number, self.asked, self._answers) for number in fogs]

    def best(self, command: Command, fogs: list[int]) -> SentCommand[Outcome, Outcome | PsmiList]:
        self.asked.append((tuple(fogs), command))
        key = CommandId(1, 7)
        drone, word, reason = (4, Word.COMPLETED, None) if self._answers[4] else (None, Word.DENIED, "none_left")
        last = Outcome(key, 2, drone, command.name, word, reason)
        return said([PsmiList(2, key, (), (), 4), Outcome(key, 2, 4, command.name, Word.ACCEPTED), last], last_word)

    async def wait_until(self, condition: Callable[[], bool], limit_s: float) -> None:
        assert condition()

    async def events(self) -> AsyncIterator[Any]:
        for event in self._heard:
            yield event
        await self.ends.wait()
        raise self.end


@contextlib.asynccontextmanager
async def connected(
    monkeypatch: pytest.MonkeyPatch, station: Station, events: Path = Path("/dev/null"), states: str = "on-change"
) -> AsyncIterator[MqttxtFleet]:
    """A fleet that is closed in the end, whatever happens."""
    monkeypatch.setattr(mqttxt_fleet, "GroundStation", station)
    fleet = MqttxtFleet("mqtt://cloud", FOGS, 0, EventLog(events, StringIO()), states)
    try:
        await fleet.connect(5)
        yield fleet
    finally:
        await fleet.close()


def _events(path: Path, kind: str) -> list[dict[str, Any]]:
    events = [json.loads(line) for line in path.read_text().splitlines()]
    return [event for event in events if event["event"] == kind]


async def test_a_station_that_the_broker_refuses_ends_the_mission_with_its_reason(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    station = Station({})
    async with connected(monkeypatch, station) as fleet:
        waiting = asyncio.create_task(fleet.changed())
        await asyncio.sleep(0)
        station.ends.set()
        for heard in (waiting, fleet.changed()):
            with pytest.raises(MissionError, match="cloud: another client took over"):
                await heard
    assert "the ground station ended: cloud: another client took over" in caplog.text


@pytest.mark.parametrize("state", [Mission(1, 0, 4, HASH), Fence(False, HASH)], ids=lambda state: state.name)
async def test_what_names_a_plan_is_written_in_hexadecimal(
    state: VitalState, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    station, path = Station({}, [StateUpdate(1, 2, state, 90, age_ms=3)]), tmp_path / "events.jsonl"
    async with connected(monkeypatch, station, path) as fleet:
        await fleet.changed()
    (written,) = _events(path, "state")
    assert written["value"][state.name] == HASH.hex()


async def test_on_change_asks_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    station = Station({})
    async with connected(monkeypatch, station):
        assert station.asked == []
    assert station.options == {"qos": 0, "bundles": False, "identity": None, "signed": False, "insecure": True}


@pytest.mark.parametrize(("states", "bundles"), [("fixed", False), ("bundle", True)])
async def test_five_states_are_asked_for_once_a_second_at_each_fog(
    states: str, bundles: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    station = Station({})
    names = ("battery", "location", "groundspeed", "flight_mode", "heading")
    async with connected(monkeypatch, station, states=states):
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
        async with connected(monkeypatch, Station({4: answer}), states="fixed"):
            pass
    assert str(failure.value) == reason


async def test_each_drone_is_sent_to_its_own_point_and_all_return_by_broadcast(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    station, path = Station({4: Word.FAILED}), tmp_path / "events.jsonl"
    points = {drone: Point(47.0 + drone / 1000, 8.0, 10.0) for drone in (1, 2, 4)}
    async with connected(monkeypatch, station, path) as fleet:
        assert await fleet.goto(points) == [
            *(CommandResult(drone, "completed") for drone in (1, 2)),
            CommandResult(4, "failed", "unknown_state"),
        ]
        assert [result.drone for result in await fleet.return_home()] == [1, 2, 4]
    assert station.asked[:3] == [(drone, Goto(47.0 + drone / 1000, 8.0, 10.0)) for drone in (1, 2, 4)]
    assert station.asked[3:] == [(1, Return()), (2, Return())]
    commands = [(event["call"], event["command"], event["drone"]) for event in _events(path, "command")]
    assert commands == [(1, "goto", 1), (2, "goto", 2), (3, "goto", 4), (4, "return", None), (5, "return", None)]


@pytest.mark.parametrize("word", [Word.COMPLETED, None])
async def test_the_fogs_choose_who_flies_to_a_point(
    word: Word | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    station, path = Station({4: word}), tmp_path / "events.jsonl"
    async with connected(monkeypatch, station, path) as fleet:
        if word is None:
            with pytest.raises(MissionError, match=r"^goto_best: denied \(none_left\)$"):
                await fleet.goto_best(Point(47.0, 8.0, 10.0))
        else:
            assert await fleet.goto_best(Point(47.0, 8.0, 10.0)) == CommandResult(4, "completed")
    assert station.asked == [((1, 2), Goto(47.0, 8.0, 10.0))]
    assert [event["chosen"] for event in _events(path, "psmi")] == [4]


async def test_a_step_bounds_its_commands_so_that_their_last_words_come_within_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with connected(monkeypatch, Station({})) as fleet:
        told_s = fleet.within(90)
        await fleet.arm()
        await fleet.land()
    limits_s = fleet._fogs[1].limits_s  # type: ignore[attr-defined]
    assert limits_s == {"arm": Arm.limit_s, "land": 90}, "its own, where that is shorter"
    assert told_s > TTL_S + 90 + 2 * GRACE_MS / 1000, "when a station's library closes a command"


async def test_a_word_about_a_fog_as_a_whole_is_that_of_each_of_its_drones(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(self: Fog, command: Command, drones: tuple[int, ...]) -> Iterable[Outcome]:
        about = (None,) if self.number == 1 else drones
        for drone in about:
            word = Word.UNCONFIRMED if drone is None else Word.COMPLETED
            yield Outcome(CommandId(1, 1), self.number, drone, command.name, word, "no_roster")

    monkeypatch.setattr(Fog, "answer", lost)
    async with connected(monkeypatch, Station({})) as fleet:
        results = await fleet.land()
    assert [str(result) for result in results if not result.completed] == [
        "drone 1: unconfirmed (no_roster)",
        "drone 2: unconfirmed (no_roster)",
    ]
    assert [result.drone for result in results] == [1, 2, 4]
