"""Calls over MQTT-XT that nobody answers, or not to the end, with a ground station that is made up."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mission import mqttxt_messages
from mission.events import EventLog
from mission.fleet import CommandResult, MissionError
from mission.mqttxt_messages import MqttxtMessageFleet
from mqttxt import Armed, BrokerRefused, Command, FogUnreachable, KnownState, Outcome, SentCommand, Word
from mqttxt.protocol.messages import CommandId
from mqttxt.station.heard import Record
from mqttxt.station.outcomes import last_word

KEY = CommandId(1, 1)


class Drone:
    """Says these words of every command, then nothing more; `raises` is raised instead of the first one."""

    def __init__(self, words: tuple[Word, ...], ends: bool = True, raises: Exception | None = None) -> None:
        self.sent: list[Command] = []
        self._words, self._ends, self._raises = words, ends, raises

    def state(self, kind: type[Armed]) -> KnownState[Armed]:
        return KnownState(kind(True), 0)

    def send(self, command: Command) -> SentCommand[Outcome, Outcome]:
        if self._raises is not None:
            raise self._raises
        self.sent.append(command)
        record = Record[Outcome]()
        for word in self._words:
            record.hear(Outcome(KEY, 1, 1, command.name, word, "disarmed" if word is Word.FAILED else None))
        if self._ends:
            record.end()
        return SentCommand(record, last_word)


class Unwilling(Drone):
    """Has one last word for each command."""

    def send(self, command: Command) -> SentCommand[Outcome, Outcome]:
        self.sent.append(command)
        record = Record[Outcome]()
        word = self._words[min(len(self.sent), len(self._words)) - 1]
        record.hear(Outcome(KEY, 1, 1, command.name, word, "why"))
        record.end()
        return SentCommand(record, last_word)


Make = Callable[[Drone], MqttxtMessageFleet]


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    for limit in ("FIRST_WORD_LIMIT_S", "LAST_WORD_LIMIT_S"):
        monkeypatch.setattr(mqttxt_messages, limit, 0.05)

    def made(drone: Drone) -> MqttxtMessageFleet:
        log = EventLog(tmp_path / "events.jsonl", StringIO())
        fleet = MqttxtMessageFleet("mqtt://cloud", {1: (1,)}, 0, log)
        fleet._fogs = {1: SimpleNamespace(number=1, drone=lambda number: drone)}  # type: ignore[dict-item]
        return fleet

    return made


def _said(tmp_path: Path) -> list[tuple[int, str, str | None]]:
    events: list[dict[str, Any]] = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert events[0]["event"] == "command"
    return [(event["call"], event["word"], event["reason"]) for event in events[1:]]


async def test_a_call_returns_at_its_first_word_and_is_settled_by_its_last(make: Make, tmp_path: Path) -> None:
    fleet = make(Drone((Word.ACCEPTED, Word.FAILED)))
    assert await fleet.call(7, "takeoff") == CommandResult(1, "accepted")
    assert await fleet.settle()
    assert _said(tmp_path) == [(7, "accepted", None), (7, "failed", "disarmed")]


async def test_a_call_that_nobody_says_a_word_of_is_the_stations_own_unconfirmed(make: Make, tmp_path: Path) -> None:
    fleet = make(Drone((), ends=False))
    assert await fleet.call(3, "goto") == CommandResult(1, "unconfirmed", "no_word")
    assert not await fleet.settle()
    assert _said(tmp_path) == [(3, "unconfirmed", "no_word")]


async def test_a_call_without_a_live_fog_is_not_sent(make: Make, tmp_path: Path) -> None:
    fleet = make(Drone((), raises=FogUnreachable("fog 1: no live activator")))
    assert await fleet.call(3, "land") == CommandResult(1, "unreachable", "not_sent")
    assert await fleet.settle()
    assert _said(tmp_path) == [(3, "unreachable", "not_sent")]


async def test_a_station_that_ends_meanwhile_is_the_missions_reason_and_holds_up_no_end(make: Make) -> None:
    fleet = make(Drone(()))
    fleet._telling = asyncio.create_task(_raises(BrokerRefused("cloud: another client took over")))
    await asyncio.wait({fleet._telling})
    with pytest.raises(MissionError, match="another client took over"):
        await fleet.request_state("battery")
    await fleet.close()


async def _raises(error: Exception) -> None:
    raise error


async def test_nothing_has_to_be_settled_before_the_first_call(make: Make) -> None:
    fleet = make(Drone(()))
    assert await fleet.settle()
    assert fleet.follows(armed=True)
    assert not fleet.follows(armed=False)


async def test_a_rate_is_asked_for_until_it_is_there(make: Make) -> None:
    drone = Unwilling((Word.EXPIRED, Word.UNREACHABLE, Word.COMPLETED))
    await make(drone).stop_state("battery")
    assert len(drone.sent) == 3


@pytest.mark.parametrize(("word", "tries"), [(Word.DENIED, 1), (Word.EXPIRED, 3)])
async def test_a_rate_that_will_not_come_is_named(word: Word, tries: int, make: Make) -> None:
    drone = Unwilling((word,))
    with pytest.raises(MissionError, match=rf"^stream battery: {word.label} \(why\)$"):
        await make(drone).request_state("battery")
    assert len(drone.sent) == tries
