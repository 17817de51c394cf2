"""Streams: states at a rate of their own, and MAVLink messages as states (sections 3 and 5)."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Inbound, Publish
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.plans import command_long
from mqttxt.drone.role import UavClient
from mqttxt.protocol.bundles import DroneBundle
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Stream
from mqttxt.protocol.messages import Word
from mqttxt.protocol.state_payload import decode_state
from mqttxt.protocol.states import Location, MavlinkState
from tests.simulation.workbench import Bench, said, written
from tests.simulation.world import (
    UAV_SESSION,
    ack,
    command_payload,
    from_autopilot,
    heartbeat,
    landed,
    on_disk,
    position,
    ready,
    results,
)

INTERVAL = 511
ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE


def attitude(system: int = 1, component: int = 1) -> Any:
    return from_autopilot(mavlink.MAVLink_attitude_message(0, 0.5, 0, 0, 0, 0, 0), system, component)


def asked(outputs: list[Any]) -> list[tuple[int, float]]:
    """Which messages the autopilot is asked for, and at which rate."""
    messages = [o.message for o in outputs if isinstance(o, Transmit) and getattr(o.message, "command", 0) == INTERVAL]
    return [(int(m.param1), 1e6 / m.param2 if m.param2 else 0.0) for m in messages]


class Streaming(Bench):
    """An autopilot that sends one kind of message at a rate of its own."""

    def stream(self, message: Any, rate_hz: float, seconds: float) -> list[Any]:
        out: list[Any] = []
        for _ in range(round(seconds * rate_hz)):
            out += self.until(self.now_ms + round(1000 / rate_hz), round(1000 / rate_hz))
            out += self.hear(message)
        return out


@pytest.fixture
def bench() -> Streaming:
    return Streaming()


def test_what_the_autopilot_does_not_send_is_asked_for_and_completed_when_it_comes(bench: Streaming) -> None:
    assert asked(bench.start(1, Stream("mavlink/ATTITUDE", 10.0))) == [(ATTITUDE, 10.0)]
    assert said(bench.hear(attitude())) == []
    assert said(bench.hear(ack(INTERVAL))) == [(1, Word.ACCEPTED, None)]
    assert said(bench.hear(attitude())) == [(1, Word.COMPLETED, None)]


def test_what_comes_often_enough_is_not_asked_for(bench: Streaming) -> None:
    bench.stream(position(), 5, 4)
    assert bench.start(1, Stream("location", 5.0)) == []
    assert said(bench.hear(position())) == [(1, Word.COMPLETED, None)]
    assert asked(bench.start(2, Stream("location", 10.0))) == [(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 10.0)]


def test_an_autopilot_is_not_slowed_down_below_its_own_rate(bench: Streaming) -> None:
    bench.stream(position(), 5, 4)
    bench.start(1, Stream("location", 20.0))
    bench.hear(ack(INTERVAL), position())
    assert asked(bench.start(2, Stream("location", 1.0))) == [(33, 0.0)]
    bench.hear(ack(INTERVAL), position())
    assert asked(bench.start(3, Stream("location", 0.0))) == []


def test_what_the_client_asked_for_itself_is_not_given_up_with_a_stream() -> None:
    """ArduPilot's own rate of most messages is 0: without a landed state, for one, every goto would be denied."""
    uav = UavClient(1, UAV_SESSION, Settings())
    ready(uav)
    out: list[Any] = []
    for now_ms in range(0, 4000, 100):
        if now_ms % 1000 == 0:
            uav.on_mavlink(heartbeat(), now_ms)
        out += uav.tick(now_ms)
    assert (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 5.0) in asked(out)
    streams = uav.executor.streams
    for now_ms in range(4000, 8000, 200):
        uav.on_mavlink(landed(1), now_ms)
    faster = streams.plan(Stream("landed_state", 20.0), 8000)
    assert faster.on_accepted is not None
    faster.on_accepted(8000)
    ended = streams.plan(Stream("landed_state", 0.0), 8000)
    assert (ended.message.param1, ended.message.param2) == (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 200_000.0)
    assert ended.on_accepted is not None
    ended.on_accepted(8000)
    assert streams.plan(Stream("landed_state", 0.0), 8000).message is None


def test_two_states_of_one_message_get_the_faster_rate(bench: Streaming) -> None:
    bench.start(1, Stream("location", 10.0))
    bench.hear(ack(INTERVAL), position())
    assert asked(bench.start(2, Stream("heading", 4.0))) == []
    bench.hear(position())
    assert asked(bench.start(3, Stream("location", 0.0))) == [(33, 4.0)]
    assert said(bench.hear(ack(INTERVAL))) == [(3, Word.ACCEPTED, None)]
    assert asked(bench.start(4, Stream("heading", 0.0))) == [(33, 0.0)]


def test_rate_0_is_completed_by_its_acknowledgement(bench: Streaming) -> None:
    bench.start(1, Stream("mavlink/ATTITUDE", 10.0))
    bench.hear(ack(INTERVAL), attitude())
    assert asked(bench.start(2, Stream("mavlink/ATTITUDE", 0.0))) == [(ATTITUDE, 0.0)]
    assert said([*bench.hear(ack(INTERVAL)), *bench.until(200)]) == [
        (2, Word.ACCEPTED, None),
        (2, Word.COMPLETED, None),
    ]
    assert said([*bench.start(3, Stream("mavlink/ATTITUDE", 0.0)), *bench.until(300)]) == [(3, Word.COMPLETED, None)]


@pytest.mark.parametrize(("state", "reason"), [("mavlink/NO_SUCH", "unknown_message"), ("altimeter", "unknown_state")])
def test_what_does_not_exist_is_denied(state: str, reason: str) -> None:
    assert said(Streaming().start(1, Stream(state, 1.0))) == [(1, Word.DENIED, reason)]


def test_what_the_autopilot_cannot_stream_is_unsupported(bench: Streaming) -> None:
    bench.start(1, Stream("mavlink/GPS2_RAW", 1.0))
    assert said(bench.hear(ack(INTERVAL, 3))) == [(1, Word.UNSUPPORTED, None)]
    assert bench.executor.streams.names == frozenset()


def test_what_was_acknowledged_and_never_comes_has_failed(bench: Streaming) -> None:
    bench.start(1, Stream("mavlink/ATTITUDE", 1.0), limit_ms=5000)
    bench.hear(ack(INTERVAL))
    assert said(bench.until(5000)) == [(1, Word.FAILED, "timeout")]
    assert bench.executor.streams.names == frozenset()


def test_a_newer_rate_takes_the_place_of_an_older_one(bench: Streaming) -> None:
    bench.start(1, Stream("mavlink/ATTITUDE", 10.0))
    assert written(bench.start(2, Stream("mavlink/ATTITUDE", 20.0))) == []
    assert said(bench.start(3, Stream("mavlink/ATTITUDE", 5.0))) == [(2, Word.SUPERSEDED, None)]
    bench.hear(ack(INTERVAL))
    out = bench.until(200)
    assert asked(out) == [(ATTITUDE, 5.0)]
    assert said(bench.hear(ack(INTERVAL))) == [(3, Word.ACCEPTED, None), (1, Word.SUPERSEDED, None)]


def test_an_autopilot_that_started_anew_is_asked_again(bench: Streaming) -> None:
    bench.start(1, Stream("mavlink/ATTITUDE", 10.0))
    bench.hear(ack(INTERVAL))
    bench.stream(attitude(), 10, 3)
    streams = bench.executor.streams
    assert streams.reminders(bench.now_ms) == []
    bench.until(20_000)
    (reminder,) = streams.reminders(bench.now_ms)
    assert (reminder.command, reminder.param1) == (INTERVAL, ATTITUDE)
    assert streams.reminders(bench.now_ms + 1000) == []


def test_questions_of_our_own_do_not_take_a_commands_acknowledgement(bench: Streaming) -> None:
    bench.start(1, Stream("mavlink/ATTITUDE", 10.0))
    question = mavlink.MAVLink_command_long_message(1, 1, INTERVAL, 0, 1, 1, 0, 0, 0, 0, 0)
    assert bench.executor.ask(question, 0) == []
    bench.hear(ack(INTERVAL), attitude())
    assert written(bench.executor.ask(question, 0)) == [INTERVAL]
    assert written(bench.start(2, Stream("mavlink/ATTITUDE", 20.0))) == []
    assert bench.hear(ack(INTERVAL)) == []
    assert asked(bench.until(100)) == [(ATTITUDE, 20.0)]


class Client:
    """A UAV client whose autopilot streams."""

    def __init__(self, bundles: bool = False) -> None:
        self.uav = UavClient(1, UAV_SESSION, Settings(bundles=bundles))
        self.now_ms = 0
        ready(self.uav)
        self.uav.tick(0)

    def command(self, state: str, rate_hz: float, seq: int = 1) -> list[Any]:
        payload = encode(command_payload(Stream(state, rate_hz), seq=seq, deadline_ms=self.now_ms + 5000))
        return [
            *on_disk(
                self.uav, self.uav.on_message("fog", Inbound("drone1/commands", payload, 1), self.now_ms), self.now_ms
            ),
            *self.uav.on_mavlink(ack(INTERVAL), self.now_ms),
        ]

    def run(self, message: Any, period_ms: int, seconds: float, state: str) -> list[Publish]:
        """What is published of a state while messages come."""
        out = self.hear(message, period_ms, seconds)
        return [e for e in out if isinstance(e, Publish) and e.topic == f"drone1/state/{state}"]

    def hear(self, message: Any, period_ms: int, seconds: float) -> list[Any]:
        out: list[Any] = []
        for _ in range(round(seconds * 1000 / period_ms)):
            self.now_ms += period_ms
            out += self.uav.on_mavlink(heartbeat(), self.now_ms)
            out += self.uav.on_mavlink(message, self.now_ms)
            if self.now_ms % 50 < period_ms:
                out += self.uav.tick(self.now_ms)
        return out


@pytest.mark.parametrize(("period_ms", "rate_hz"), [(20, 20.0), (20, 50.0), (100, 10.0), (10, 7.0)])
def test_messages_are_published_at_the_rate_that_was_asked_for(period_ms: int, rate_hz: float) -> None:
    client = Client()
    client.command("mavlink/ATTITUDE", rate_hz)
    published = client.run(attitude(), period_ms, 10, "mavlink/ATTITUDE")
    assert len(published) == pytest.approx(10 * rate_hz, abs=2)
    state = decode_state("mavlink/ATTITUDE", published[-1].payload, relayed=False).state
    assert isinstance(state, MavlinkState)
    assert state.values["roll"] == 0.5


def test_a_state_comes_at_its_rate_whether_or_not_it_changes_and_on_change_again_afterwards() -> None:
    client = Client()
    client.run(position(), 100, 5, "location")
    client.command("location", 5.0)
    published = client.run(position(), 100, 4, "location")
    assert len(published) == pytest.approx(20, abs=1)
    assert decode_state("location", published[0].payload, relayed=False).state == Location(
        47.397742, 8.545594, 488.0, 0.0
    )
    client.command("location", 0.0, seq=2)
    assert len(client.run(position(), 100, 4, "location")) <= 1


def _bundled(outputs: list[Any]) -> list[set[str]]:
    published = [e for e in outputs if isinstance(e, Publish) and e.topic == "drone1/states"]
    return [{one.state.name for one in decode(DroneBundle, e.payload).states} for e in published]


def test_states_at_once_a_second_travel_in_the_bundle_of_each_second() -> None:
    client = Client(bundles=True)
    client.hear(position(), 100, 3)
    for seq, state in enumerate(("location", "heading", "flight_mode"), start=1):
        client.command(state, 1.0, seq=seq)
    out = client.hear(position(), 100, 10)
    assert not [e for e in out if isinstance(e, Publish) and e.topic.startswith("drone1/state/")]
    full = [names for names in _bundled(out) if {"location", "heading", "flight_mode"} <= names]
    assert len(full) == pytest.approx(10, abs=1)


def test_bundles_keep_their_second_though_ticks_are_late() -> None:
    client = Client(bundles=True)
    client.command("location", 1.0)
    client.now_ms = 7
    bundles = _bundled(client.hear(position(), 130, 39))
    assert len([names for names in bundles if "location" in names]) == pytest.approx(39, abs=1)


def test_a_state_faster_than_bundles_and_a_message_as_it_is_leave_alone() -> None:
    client = Client(bundles=True)
    client.hear(position(), 100, 3)
    client.command("location", 5.0, seq=1)
    assert len(client.run(position(), 100, 4, "location")) == pytest.approx(20, abs=1)
    client.command("mavlink/ATTITUDE", 1.0, seq=2)
    assert len(client.run(attitude(), 100, 4, "mavlink/ATTITUDE")) == pytest.approx(4, abs=1)


def test_a_state_of_a_parameter_is_repeated() -> None:
    client = Client()
    client.uav.on_mavlink(from_autopilot(mavlink.MAVLink_param_value_message(b"MPC_XY_VEL_MAX", 12.0, 9, 1, 0)), 0)
    effects = client.command("max_groundspeed", 2.0)
    assert [e for e in effects if isinstance(e, Transmit)] == []
    assert len(client.run(position(), 100, 4, "max_groundspeed")) == pytest.approx(8, abs=1)
    again = Inbound("drone1/commands", encode(command_payload(Stream("max_groundspeed", 2.0))), 1)
    assert results(client.uav.on_message("fog", again, client.now_ms))[0].word is Word.COMPLETED


def test_only_the_autopilots_own_messages_are_published() -> None:
    client = Client()
    client.command("mavlink/ATTITUDE", 10.0)
    assert client.run(attitude(component=100), 100, 1, "mavlink/ATTITUDE") == []
    assert client.run(attitude(system=2), 100, 1, "mavlink/ATTITUDE") == []


def test_what_wrote_no_mode_leaves_nothing_behind_that_would_grow() -> None:
    bench = Bench()
    for seq in range(20):
        bench.start(seq, Stream("location", 0.0))
        bench.hear(ack(INTERVAL))
    assert bench.executor._runs._ended == []


def test_requests_that_nobody_answers_leave_nothing_behind_that_would_grow() -> None:
    bench = Bench()
    question = command_long(bench.vehicle, INTERVAL, 33.0, 200_000.0)
    for _ in range(20):
        bench.executor.ask(question, bench.now_ms)
        bench.until(bench.now_ms + 10_000, 10_000)
    (left,) = bench.executor._runs.acks._own.values()
    assert len(left) == 1
