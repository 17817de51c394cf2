"""Whatever arrives, in whatever order: no role raises, and what it says can be carried (section 3, R3.3)."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any
from unittest.mock import patch

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.activator.role import Activator
from mqttxt.core.effects import Inbound, Log, Publish, Stop, Subscribe
from mqttxt.core.settings import Settings
from mqttxt.drone.answers import Unfinished
from mqttxt.drone.effects import Journal, LoadReadings, StoreReading, Transmit
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.errors import ConfigurationError, FogUnreachable
from mqttxt.protocol.cbor import MAX_PAYLOAD
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Goto, Takeoff
from mqttxt.protocol.messages import BeaconMessage, CommandId, CommandMessage, FogPresence, Presence
from mqttxt.protocol.topic_table import CLOUD_SIDE, FOG_SIDE, SENSOR_SIDE
from mqttxt.protocol.values import Encoding
from mqttxt.station.role import StationRole
from tests.simulation.strategies import PAYLOADS, inbound, messages
from tests.simulation.world import FOG_SESSION, GS_SESSION, UAV_SESSION, heartbeat, home, landed, position

NONCE = 7
KNOWN = (GS_SESSION, FOG_SESSION, UAV_SESSION, NONCE, 0, 1, 5000)
EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "30"))
LONGEST_TOPIC = 65_535

PATIENT = settings(
    max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
ROLE_SETTINGS = st.builds(Settings, st.integers(0, 1), st.sampled_from(Encoding))
PAUSES = st.sampled_from([0, 50, 1000, 5000, 31_000, 700_000])
CODES = st.sampled_from([0, 0x10, 0x80, 0x97])


@dataclass
class FuzzBench:
    """A role with nothing around it but these answers: every subscription is granted, every write happens."""

    role: Any
    links: tuple[Any, ...]
    now_ms: int = 10_000
    refs: list[tuple[Any, Any]] = field(default_factory=list)
    said: list[Publish] = field(default_factory=list)

    def carry_out(self, outputs: Iterable[Any]) -> None:
        for output in outputs:
            if isinstance(output, Publish):
                assert len(output.payload) <= MAX_PAYLOAD
                assert 0 < len(output.topic.encode()) <= LONGEST_TOPIC
                assert not set("+#") & set(output.topic)
                self.said.append(output)
                if output.ref is not None:
                    self.refs.append((output.link, output.ref))
            elif isinstance(output, Subscribe):
                self.carry_out(self.role.on_subscribed(output, self.now_ms))
            elif isinstance(output, Transmit) and output.ref is not None:
                self.carry_out(self.role.on_transmitted(output.ref, self.now_ms))
            elif isinstance(output, Journal) and output.is_opening:
                assert isinstance(output.id, CommandId)
                taken = len(self.said) % 5 != 0  # every now and then the disk is full
                answer = self.role.desk.on_journalled if taken else self.role.desk.on_not_journalled
                self.carry_out(answer(output.id, self.now_ms))
            else:
                assert not isinstance(output, Log | Stop) or str(output)

    def hear(self, *message: Any) -> None:
        self.carry_out(self.role.on_message(*message, self.now_ms))

    def wait(self, pause_ms: int) -> None:
        self.now_ms += pause_ms
        self.carry_out(self.role.tick(self.now_ms))


def steps(*kinds: st.SearchStrategy[Any]) -> st.SearchStrategy[list[Any]]:
    return st.lists(st.one_of(*kinds, PAUSES), max_size=25)


CLOCKS = st.sampled_from([0, 5000, 100_000, 2**32, 2**53 - 1])
"""What another process's clock may read: young, old, and as far as a payload can carry."""


def beacon(session: int, now_ms: int) -> bytes:
    return encode(BeaconMessage(session=session, now_ms=now_ms, nonce=NONCE, held_ms=0))


def up(session: int) -> bytes:
    return encode(Presence(session=session, up=True))


CLOUD_TRAFFIC = inbound(CLOUD_SIDE, KNOWN)
FOG_TRAFFIC = inbound(FOG_SIDE, KNOWN)
COMMANDS = messages(CommandMessage, (GS_SESSION, FOG_SESSION, UAV_SESSION, 1, 2))
"""They are given the receiver's session and a deadline that is still to come."""


@PATIENT
@given(
    ROLE_SETTINGS,
    CLOCKS,
    steps(st.tuples(st.just("cloud"), CLOUD_TRAFFIC), st.tuples(st.just("fog"), FOG_TRAFFIC), COMMANDS, CODES),
)
def test_nothing_on_either_broker_makes_an_activator_raise(how: Settings, drone_ms: int, traffic: list[Any]) -> None:
    with patch("secrets.randbelow", lambda _: NONCE):
        bench = FuzzBench(Activator(1, FOG_SESSION, how, drones=(1,)), ("cloud", "fog"))
        for link in bench.links:
            bench.carry_out(bench.role.on_connected(link, bench.now_ms))
        bench.hear("cloud", Inbound("fog1/clock", beacon(FOG_SESSION, bench.now_ms)))
        bench.hear("fog", Inbound("drone1/reachable", up(UAV_SESSION)))
        bench.hear("fog", Inbound("drone1/clock", beacon(UAV_SESSION, drone_ms)))
        for step in traffic:
            if isinstance(step, CommandMessage):
                timely = replace(step, executor_session=FOG_SESSION, deadline_ms=bench.now_ms + 3000)
                bench.hear("cloud", Inbound("fog1/drone1/commands", encode(timely, how.encoding), how.qos))
            elif isinstance(step, tuple):
                bench.hear(*step)
                bench.wait(50)
            elif step in (0x10, 0x80, 0x97):
                for link, ref in bench.refs[-3:]:
                    bench.carry_out(bench.role.on_published(link, ref, step, bench.now_ms))
                bench.carry_out(bench.role.on_disconnected("fog", bench.now_ms))
                bench.carry_out(bench.role.on_connected("fog", bench.now_ms))
            else:
                bench.wait(step)
        bench.wait(10_000)
        bench.carry_out(bench.role.goodbye(bench.now_ms))


def frames(identifiers: tuple[int, ...]) -> st.SearchStrategy[Any]:
    """Valid MAVLink frames with any contents, as they come out of the parser."""

    @st.composite
    def build(draw: st.DrawFn) -> Any:
        cls = mavlink.mavlink_map[draw(st.sampled_from(identifiers))]
        size = cls.unpacker.size
        contents = draw(st.binary(min_size=size, max_size=size))
        system, component = draw(st.sampled_from([1, 1, 1, 2, 255])), draw(st.sampled_from([1, 1, 191]))
        body = bytes([size, 0, 0, 0, system, component, cls.id & 255, cls.id >> 8 & 255, cls.id >> 16]) + contents
        crc = mavlink.x25crc(body)
        crc.accumulate(bytes([cls.crc_extra]))
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        (found,) = parser.parse_buffer(b"\xfd" + body + crc.crc.to_bytes(2, "little"))
        return found

    return build()


AUTOPILOT = frames(
    (
        *(mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_COMMAND_ACK, mavlink.MAVLINK_MSG_ID_HOME_POSITION),
        *(mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT),
        *(mavlink.MAVLINK_MSG_ID_VFR_HUD, mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE),
        *(mavlink.MAVLINK_MSG_ID_SYS_STATUS, mavlink.MAVLINK_MSG_ID_PARAM_VALUE, mavlink.MAVLINK_MSG_ID_ATTITUDE),
        *(mavlink.MAVLINK_MSG_ID_STATUSTEXT, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT),
    )
)
LEFT = st.builds(
    Unfinished, st.builds(CommandId, st.sampled_from([GS_SESSION, 9]), st.integers(0, 5)), st.sampled_from(["arm", "x"])
)


@PATIENT
@given(ROLE_SETTINGS, st.lists(LEFT, max_size=3), st.booleans(), steps(FOG_TRAFFIC, AUTOPILOT, COMMANDS, CODES))
def test_nothing_from_broker_or_autopilot_makes_a_uav_client_raise(
    how: Settings, left: list[Unfinished], healthy: bool, traffic: list[Any]
) -> None:
    client = UavClient(1, UAV_SESSION, how, unfinished=left)
    bench = FuzzBench(client, ())
    if healthy:
        for message in (heartbeat(), home(), position(), landed(1)):
            client.on_mavlink(message, bench.now_ms)
    bench.carry_out(client.on_connected("fog", bench.now_ms))
    for step in traffic:
        if isinstance(step, Inbound):
            bench.hear("fog", step)
            bench.wait(50)
        elif isinstance(step, CommandMessage):
            timely = replace(step, executor_session=UAV_SESSION, deadline_ms=bench.now_ms + 3000)
            bench.hear("fog", Inbound("drone1/commands", encode(timely, how.encoding), how.qos))
        elif not isinstance(step, int):
            bench.carry_out(client.on_mavlink(step, bench.now_ms))
            bench.wait(50)
        elif step in (0x10, 0x80, 0x97):
            for _, ref in bench.refs[-3:]:
                bench.carry_out(client.on_published("fog", ref, step, bench.now_ms))
            bench.carry_out(client.on_disconnected("fog", bench.now_ms))
            bench.carry_out(client.on_connected("fog", bench.now_ms))
        else:
            bench.wait(step)
    bench.wait(10_000)
    bench.carry_out(client.goodbye(bench.now_ms))


SENSOR_TRAFFIC = inbound(SENSOR_SIDE, KNOWN)


class CarrierBench(FuzzBench):
    """Beside the answers of a bench, a store that keeps what it is given, or has no room for it."""

    def __init__(self, client: UavClient, has_room: bool) -> None:
        super().__init__(client, ())
        assert client.carrier is not None
        self.carrier = client.carrier
        self.stored: list[Any] = []
        self.has_room = has_room

    def carry_out(self, outputs: Iterable[Any]) -> None:
        for output in outputs:
            if isinstance(output, StoreReading):
                self.stored += [output.reading] if self.has_room else []
                answer = self.carrier.on_stored if self.has_room else partial(self.carrier.on_refused, reason="full")
                self.carry_out(answer([output], now_ms=self.now_ms))
            elif isinstance(output, LoadReadings):
                rows = list(enumerate(self.stored, start=1))[output.after : output.after + output.most]
                self.carry_out(self.carrier.on_loaded(rows, output.most, self.now_ms))
            else:
                super().carry_out([output] if not isinstance(output, Subscribe) or output.link == "fog" else [])


@PATIENT
@given(ROLE_SETTINGS, st.booleans(), steps(st.tuples(SENSOR_TRAFFIC), FOG_TRAFFIC, CODES))
def test_nothing_from_sensors_makes_a_uav_client_raise(how: Settings, has_room: bool, traffic: list[Any]) -> None:
    client = UavClient(1, UAV_SESSION, how, options=UavOptions(carries_sensors=True))
    bench = CarrierBench(client, has_room)
    for message in (heartbeat(), home(), position(), landed(1)):
        client.on_mavlink(message, bench.now_ms)
    bench.carry_out(client.on_connected("fog", bench.now_ms))
    bench.carry_out(bench.carrier.on_connected(bench.now_ms))
    for step in traffic:
        if isinstance(step, tuple):
            bench.carry_out(bench.carrier.on_message(step[0], bench.now_ms))
        elif isinstance(step, Inbound):
            bench.hear("fog", step)
        elif step in (0x10, 0x80, 0x97):
            for _, ref in bench.refs[-3:]:
                bench.carry_out(client.on_published("fog", ref, step, bench.now_ms))
        bench.wait(50 if not isinstance(step, int) or step in (0x10, 0x80, 0x97) else step)
    bench.wait(10_000)


ORDERS = st.tuples(st.sampled_from([None, 1, 2]), st.sampled_from([Arm(), Takeoff(10.0), Goto(47.0, 8.0, 10.0)]))


@PATIENT
@given(ROLE_SETTINGS, CLOCKS, steps(CLOUD_TRAFFIC, ORDERS, CODES))
def test_nothing_on_the_cloud_broker_makes_a_ground_station_raise(
    how: Settings, fog_ms: int, traffic: list[Any]
) -> None:
    with patch("secrets.randbelow", lambda _: NONCE):
        station = StationRole("g", GS_SESSION, how)
        bench = FuzzBench(station, ())
        bench.carry_out(station.add_fogs([1]))
        bench.carry_out(station.on_connected("cloud", bench.now_ms))
        bench.hear("cloud", Inbound("fog1/reachable", encode(FogPresence(session=FOG_SESSION, up=True))))
        bench.hear("cloud", Inbound("fog1/clock", beacon(FOG_SESSION, fog_ms)))
        for step in traffic:
            if isinstance(step, Inbound):
                bench.hear("cloud", step)
                bench.wait(50)
            elif isinstance(step, tuple):
                try:
                    _, sent = station.commands.send(station.fog(1), *step, bench.now_ms)
                except (FogUnreachable, ConfigurationError):
                    continue
                bench.carry_out(sent)
            elif step in (0x10, 0x80, 0x97):
                bench.carry_out(station.on_disconnected("cloud", bench.now_ms))
                bench.carry_out(station.on_connected("cloud", bench.now_ms))
            else:
                bench.wait(step)
        bench.wait(10_000)
        bench.carry_out(station.goodbye(bench.now_ms))


@PATIENT
@given(PAYLOADS)
def test_bytes_on_a_topic_of_its_own_never_make_a_role_raise(payload: bytes) -> None:
    station = StationRole("g", GS_SESSION, Settings())
    station.add_fogs([1])
    activator = Activator(1, FOG_SESSION, Settings())
    client = UavClient(1, UAV_SESSION, Settings())
    for row in CLOUD_SIDE:
        topic = row.topic.replace("X", "1").replace("Y", "1").replace("S/", "3/")
        station.on_message("cloud", Inbound(topic, payload), 0)
        activator.on_message("cloud", Inbound(topic, payload), 0)
    for row in FOG_SIDE:
        topic = row.topic.replace("Y", "1").replace("S/", "3/")
        activator.on_message("fog", Inbound(topic, payload), 0)
        client.on_message("fog", Inbound(topic, payload), 0)
