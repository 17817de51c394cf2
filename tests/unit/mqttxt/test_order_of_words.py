"""What is said of a command, in which order: no definite no behind a first word, and no write before its record.

Stations, activators, UAV clients and journals are driven through any order of commands, acknowledgements, full disks,
losses and restarts.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt.core.effects import Inbound, Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Journal, Transmit
from mqttxt.drone.role import UavClient
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Arm, Hold, Land, Takeoff
from mqttxt.protocol.messages import ResultMessage, Word
from mqttxt.station.outcomes import Outcome
from tests.simulation.fogs import ActivatorBench
from tests.simulation.world import GS_SESSION, World, ack, command_payload, heartbeat, ready

COMMANDS = (Arm(), Takeoff(10.0), Land(), Hold())
MAV_CMDS = (400, 22, 21, 176)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("send"), st.sampled_from(COMMANDS), st.sampled_from([1, None])),
        st.tuples(st.just("ack"), st.sampled_from(MAV_CMDS), st.sampled_from([0, 0, 0, 1, 2, 3, 4, 5])),
        st.tuples(st.just("disk"), st.booleans()),
        st.tuples(st.just("time"), st.sampled_from([50, 200, 600, 2500, 7000])),
        st.tuples(st.just("uav"), st.booleans()),
        st.tuples(st.just("activator")),
        st.tuples(st.just("lost"), st.sampled_from([(), ("commands_result",), ("commands",), ("arm", "hold")])),
        st.tuples(st.just("again")),
        st.tuples(st.just("armed"), st.booleans()),
    ),
    max_size=40,
)


def play(world: World, steps: Iterable[tuple[Any, ...]]) -> None:
    """Let it all happen."""
    sessions = iter(range(1000, 10_000))
    for what, *how in steps:
        if what == "send":
            if world.gs.fogs[1].registered and world.gs.fogs[1].is_live(world.now_ms):
                world.send(how[0], how[1], limit_s=5)
        elif what == "ack":
            world.autopilot(ack(*how))
        elif what == "disk":
            world.disk.is_full = how[0]
        elif what == "time":
            world.pass_time(how[0])
        elif what == "uav":
            if not how[0]:
                world.disk.unfinished.clear()
            world.restart_uav(next(sessions), list(world.disk.unfinished.values()), remembers=how[0])
        elif what == "activator":
            world.restart_activator(next(sessions))
        elif what == "lost":
            world.drop = set(how[0])
        elif what == "armed":
            world.autopilot(heartbeat(armed=how[0]))
        else:
            world.run("gs", world.gs.commands.ask_again(1, world.now_ms))


def contradictions(said: Iterable[tuple[Any, Word]]) -> list[Any]:
    """Of whom a definite no was said behind a first word."""
    begun, found = set(), []
    for who, word in said:
        if not word.is_last:
            begun.add(who)
        elif word.is_definite_no and who in begun:
            found.append((who, word))
    return found


@given(STEPS, st.sampled_from([0, 1]))
def test_no_station_hears_a_definite_no_behind_a_first_word_whatever_is_restarted_full_or_lost(
    steps: list[tuple[Any, ...]], qos: int
) -> None:
    world = World(qos=qos).start(1000)
    play(world, steps)
    world.drop = set()
    world.pass_time(70_000, step_ms=500)
    heard = [outcome for outcome in world.heard if isinstance(outcome, Outcome)]
    assert contradictions(((o.id, o.drone), o.word) for o in heard) == []
    last = [(o.id, o.drone) for o in heard if o.is_last]
    assert len(last) == len(set(last))
    results_of = {
        name: [
            (decode(ResultMessage, publish.payload), publish.topic)
            for sender, publish in world.sent
            if sender == name and "/commands_result/" in publish.topic and "drone1" in publish.topic
        ]
        for name in ("uav", "activator")
    }
    for name, found in results_of.items():
        assert contradictions(((result.id, result.session), result.word) for result, _ in found) == [], name


@given(STEPS)
def test_nothing_is_written_to_the_autopilot_that_the_journal_does_not_have(steps: list[tuple[Any, ...]]) -> None:
    world = World().start(1000)
    order: list[Any] = []
    takes, write = world.disk.takes, world._write

    def recorded(effect: Journal) -> bool:
        taken = takes(effect)
        order.extend([effect.id] if taken and effect.is_opening else [])
        return taken

    def written(effect: Transmit) -> None:
        assert effect.ref is None or effect.ref in order
        write(effect)

    world.disk.takes = recorded  # type: ignore[method-assign]
    world._write = written  # type: ignore[method-assign]
    play(world, steps)


def test_a_command_that_the_disk_does_not_take_is_denied_and_never_sent() -> None:
    world = World().start(1000)
    world.disk.is_full = True
    world.send(Arm())
    world.pass_time(3000)
    heard = [outcome for outcome in world.heard if isinstance(outcome, Outcome)]
    assert [(outcome.word, outcome.reason) for outcome in heard] == [(Word.DENIED, "journal")]
    assert world.wrote == []
    world.disk.is_full = False
    world.send(Arm())
    assert len(world.wrote) == 1


def test_what_was_accepted_before_the_disk_filled_is_unconfirmed_after_a_restart_and_not_expired() -> None:
    world = World().start(1000)
    world.send(Arm())
    world.autopilot(ack(400))
    world.disk.is_full = True
    world.restart_uav(0x44, list(world.disk.unfinished.values()))
    world.pass_time(1000)
    words = [(o.word, o.reason) for o in world.heard if isinstance(o, Outcome)]
    assert words == [(Word.ACCEPTED, None), (Word.UNCONFIRMED, "restarted")]


def test_a_refusal_needs_no_place_in_the_journal() -> None:
    """A restarted client says `expired` of an id that it does not know: a definite no too."""
    uav = UavClient(1, 0x33, Settings())
    ready(uav)
    for seq in range(10):
        late = encode(command_payload(Arm(), seq=seq, deadline_ms=None))
        assert not any(
            isinstance(effect, Journal) for effect in uav.on_message("fog", Inbound("drone1/commands", late, 1), 0)
        )


@pytest.mark.parametrize("no", [Word.EXPIRED, Word.DENIED, Word.UNREACHABLE, Word.UNSUPPORTED, Word.OVERTAKEN])
@pytest.mark.parametrize("first", [Word.ACCEPTED, Word.IN_PROGRESS])
def test_an_activator_and_a_station_make_a_contradiction_unconfirmed(first: Word, no: Word) -> None:
    bench = ActivatorBench()
    bench.appear()
    bench.register()
    bench.command()
    bench.result(first)
    said = [decode(ResultMessage, e.payload) for e in bench.result(no) if isinstance(e, Publish)]
    assert [(one.word, one.reason) for one in said] == [(Word.UNCONFIRMED, f"{no.label} after {first.label}")]

    world = World().start(1000)
    world.drop = {"arm"}
    command_id = world.send(Arm())
    world.drop = set()
    for word in (first, no):
        result = ResultMessage(
            gs_session=GS_SESSION, seq=command_id.seq, session=0x22, stamp=0, relay_stamp=0, word=word
        )
        world.run(
            "gs", world.gs.on_message("cloud", Inbound("fog1/drone1/commands_result/arm", encode(result)), world.now_ms)
        )
    words = [(o.word, o.reason) for o in world.heard if isinstance(o, Outcome) and o.id == command_id]
    assert words == [(first, None), (Word.UNCONFIRMED, f"{no.label} after {first.label}")]


def test_a_choice_does_not_go_on_behind_a_contradiction() -> None:
    """The first drone may fly: nobody else is sent."""
    from tests.unit.mqttxt.test_psmi import TARGET, flock, sent_to

    bench = flock(2, 1)
    bench.select(TARGET)
    bench.word(2, Word.ACCEPTED)
    assert sent_to(bench.word(2, Word.EXPIRED)) == []
