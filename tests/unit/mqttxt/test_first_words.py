"""First words that wait at the drone for its bundle, and states that leave beside words (docs/protocol.md, R10.7)."""

from __future__ import annotations

from typing import Any

import pytest

from mqttxt.core.effects import Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.role import UavClient
from mqttxt.drone.runs import Said
from mqttxt.protocol.commands import Arm, Command, Hold, Land
from mqttxt.protocol.messages import CommandId, Word
from mqttxt.protocol.states import Armed, Battery
from tests.simulation.world import (
    GS_SESSION,
    UAV_SESSION,
    World,
    ack,
    command_payload,
    heartbeat,
    on_disk,
    ready,
    results,
)

INTERVAL_MS = Settings().bundle_ms
BUNDLE = "drone1/states"


class Bench:
    """A UAV client that bundles, whose commands are journalled at once; its first bundle has left at 0."""

    def __init__(self, bundles: bool = True) -> None:
        self.client = UavClient(1, UAV_SESSION, Settings(bundles=bundles))
        ready(self.client)
        self.client.tick(0)
        self.desk = self.client.desk

    def accepts(self, command: Command, seq: int = 1) -> Bench:
        """Start a command, of which the executor says that it was accepted."""
        self.command(command, seq)
        assert self.says(Word.ACCEPTED, seq) == []
        return self

    def command(self, command: Command, seq: int = 1, **changed: Any) -> list[Any]:
        message = command_payload(command, seq=seq, **changed)
        return on_disk(self.client, self.desk._on_command(message, False, 0), 0)

    def says(self, word: Word, seq: int = 1, now_ms: int = 0, **more: Any) -> list[Word]:
        """What leaves where the executor says a word of a command."""
        said = Said(CommandId(GS_SESSION, seq), word, **more)
        return words(self.desk.answers.give([said], now_ms))

    def states(self, *states: Any) -> None:
        for state in states:
            self.client._states.throttle.update(state)


def words(effects: list[Any]) -> list[Word]:
    return [result.word for result in results(effects)]


def topics(effects: list[Any]) -> list[str]:
    return [effect.topic for effect in effects if isinstance(effect, Publish)]


@pytest.mark.parametrize("word", [Word.ACCEPTED, Word.IN_PROGRESS])
def test_a_first_word_leaves_alone_when_it_has_waited_long_enough(word: Word) -> None:
    bench = Bench()
    bench.command(Arm())
    assert bench.says(word, now_ms=10) == []
    assert words(bench.client.tick(9 + INTERVAL_MS)) == []
    said, *_ = results(bench.client.tick(10 + INTERVAL_MS))
    assert (said.word, said.stamp) == (word, 1)  # of when the autopilot said so
    assert words(bench.client.tick(11 + INTERVAL_MS)) == []


def test_it_leaves_with_the_bundle() -> None:
    bench = Bench().accepts(Arm())
    bench.states(Armed(True))
    left = topics(bench.client.tick(100))
    assert left == ["drone1/commands_result/arm", BUNDLE]


@pytest.mark.parametrize("word", [word for word in Word if word.is_last and not word.is_definite_no])
def test_the_word_behind_it_leaves_in_its_place(word: Word) -> None:
    bench = Bench().accepts(Arm())
    assert bench.says(word) == [word]
    assert words(bench.client.tick(INTERVAL_MS)) == []


def test_progress_takes_its_place_and_its_time_and_the_end_leaves_at_once() -> None:
    bench = Bench().accepts(Land())
    assert bench.says(Word.IN_PROGRESS, percent=10, now_ms=500) == []
    assert words(bench.client.tick(INTERVAL_MS)) == [Word.IN_PROGRESS]
    assert bench.says(Word.COMPLETED, now_ms=INTERVAL_MS) == [Word.COMPLETED]


def test_a_no_behind_it_is_no_definite_one_although_it_was_not_heard() -> None:
    bench = Bench().accepts(Arm())
    assert bench.says(Word.DENIED, reason="x") == [Word.UNCONFIRMED]


@pytest.mark.parametrize(("bundles", "more"), [(False, {}), (True, {"late_ms": 3})])
def test_without_bundles_and_with_a_late_write_nothing_waits(bundles: bool, more: dict[str, int]) -> None:
    bench = Bench(bundles)
    bench.command(Arm())
    assert bench.says(Word.ACCEPTED, **more) == [Word.ACCEPTED]


def test_what_is_said_of_another_command_leaves_behind_it() -> None:
    bench = Bench()
    bench.accepts(Arm(), 1).accepts(Land(), 2).command(Hold(), 3)
    out = bench.desk.answers.give([Said(CommandId(GS_SESSION, 3), Word.FAILED, "x")], 0)
    assert [(said.seq, said.word) for said in results(out)] == [
        (1, Word.ACCEPTED),
        (2, Word.ACCEPTED),
        (3, Word.FAILED),
    ]
    assert bench.desk.answers._first_words.take() == []


@pytest.mark.parametrize("changed", [{"seq": 1, "command": Hold()}, {"seq": 2, "deadline_ms": 90_000}])
def test_a_denial_does_not_overtake_it(changed: dict[str, Any]) -> None:
    """An id in conflict, above all: its denial in front of `accepted` would be a definite no."""
    bench = Bench().accepts(Arm())
    assert words(bench.command(**{"command": Arm(), **changed})) == [Word.ACCEPTED, Word.DENIED]


def test_a_duplicate_is_answered_with_it_once() -> None:
    bench = Bench().accepts(Arm())
    assert words(bench.command(Arm())) == [Word.ACCEPTED]
    assert words(bench.client.tick(INTERVAL_MS)) == []
    assert bench.says(Word.COMPLETED, now_ms=INTERVAL_MS) == [Word.COMPLETED]


def test_a_duplicate_that_is_not_answered_takes_nothing_from_it() -> None:
    bench = Bench()
    bench.command(Arm())
    bench.says(Word.IN_PROGRESS, percent=1)
    assert words(bench.command(Arm())) == [Word.IN_PROGRESS]
    bench.says(Word.IN_PROGRESS, percent=2)
    assert words(bench.command(Arm())) == []  # so soon again
    assert words(bench.client.tick(INTERVAL_MS))[0] == Word.IN_PROGRESS


def test_it_leaves_before_down_and_after_a_lost_connection() -> None:
    bench = Bench().accepts(Arm())
    bench.client.on_disconnected("fog", 0)
    assert words(bench.client.tick(INTERVAL_MS)) == []
    assert words(bench.desk.answers.republish()) == []  # nothing is published before its birth
    bench.desk.answers.may_publish = True
    assert words(bench.desk.answers.republish()) == [Word.ACCEPTED]
    bench.accepts(Land(), 2)
    assert words(bench.client.goodbye(0))[:1] == [Word.ACCEPTED]


@pytest.mark.parametrize("bundles", [True, False])
def test_the_states_that_wait_leave_beside_a_word(bundles: bool) -> None:
    world = World(bundles=bundles).start()
    world.pass_time(3000)
    world.send(Arm(), 1)
    world.autopilot(ack(400))
    world.uav._states.throttle.update(Battery(12))
    mark = len(world.sent)
    world.autopilot(heartbeat(armed=True))
    left = topics([publish for who, publish in world.sent[mark:] if who == "uav"])
    assert left[0] == "drone1/commands_result/arm"
    assert (BUNDLE in left) is bundles


def test_a_word_with_nothing_beside_it_puts_the_next_bundle_off_in_no_way() -> None:
    bench = Bench()
    next_ms = bench.client._states._next_bundle_ms
    assert bench.client._states.bundle(next_ms - 500, early=True) == []
    assert bench.client._states._next_bundle_ms == next_ms


def test_a_station_hears_that_it_was_completed() -> None:
    world = World(bundles=True).start()
    world.pass_time(1000)
    sent = world.send(Arm())
    world.autopilot(ack(400), heartbeat(armed=True))
    assert [(o.id, o.word) for o in world.heard if hasattr(o, "word")] == [(sent, Word.COMPLETED)]
