"""The gateway as a whole, at a made-up station: who is shown to whom, whose messages are heard (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import (
    Airframe,
    Arm,
    Armed,
    AutopilotText,
    Battery,
    CommandId,
    ControlChanged,
    FlightMode,
    FlightModeName,
    Fog,
    GroundStation,
    KnownState,
    Land,
    Location,
    MavlinkState,
    Outcome,
    Severity,
    State,
    StateUpdate,
    StationEnded,
    VelocityNed,
    Word,
)
from mqttxt.gateway import standstill
from mqttxt.gateway.endpoints import ClientAddress
from mqttxt.gateway.modes import PX4
from mqttxt.gateway.process import SILENT_MS, Gateway
from mqttxt.gateway.telemetry import LOCAL
from mqttxt.station.views import STALE_MS
from tests.rigs.loopback import free_port
from tests.simulation import desk
from tests.simulation.page_fleet import FakeStation

pytestmark = pytest.mark.long

KNOWN = (
    Airframe(PX4, 2, 0x010F00FF),
    Armed(False),
    FlightMode(FlightModeName.HOLD),
    Location(47.0, 8.0, 498.0, 10.0),
    VelocityNed(0.0, 0.0, 0.0),
)


class FakeDrone(desk.FakeDrone):
    """A drone with states; its station has control of it where a test gives it, and keeps it."""

    fog = 1

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number
        self.grants = False
        self.states = {state.name: KnownState(state, 100) for state in KNOWN}

    def release(self) -> None:
        pass

    def state(self, kind: type[State]) -> Any:
        return self.states.get(kind.name)

    def age(self, age_ms: int) -> None:
        self.states = {name: replace(known, age_ms=age_ms) for name, known in self.states.items()}


class Socket:
    """A client on TCP, with every message that it has been sent."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, system: int) -> None:
        self._writer = writer
        self._encoder = mavlink.MAVLink(None, system, 190)
        self._decoder = mavlink.MAVLink(None)
        self.messages: list[Any] = []
        self._reading = asyncio.create_task(self._read(reader))

    async def _read(self, reader: asyncio.StreamReader) -> None:
        while data := await reader.read(65_536):
            self.messages += self._decoder.parse_buffer(data) or []

    def say(self, *messages: Any) -> None:
        for message in messages:
            self._writer.write(message.pack(self._encoder))

    def of(self, kind: str, drone: int = 1) -> list[Any]:
        found = [message for message in self.messages if message.get_type() == kind]
        return [message for message in found if message.get_srcSystem() == drone]

    async def close(self) -> None:
        self._reading.cancel()
        self._writer.transport.abort()


class Bench:
    def __init__(self) -> None:
        self.station = FakeStation()
        self.drones = [FakeDrone(1), FakeDrone(2)]
        self.port = free_port()
        self.gateway = Gateway(cast(GroundStation, self.station), 5.0, take_over=False)
        self.fog = SimpleNamespace(drones=[*self.drones])
        fogs = cast("list[Fog]", [self.fog])
        self.running = asyncio.create_task(self.gateway.run(fogs, [], [ClientAddress("tcp", "127.0.0.1", self.port)]))
        self.clients: list[Socket] = []

    async def client(self, system: int = 255) -> Socket:
        """One that has heard of a drone."""
        async with asyncio.timeout(10):
            while True:
                with contextlib.suppress(OSError):
                    reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
                    break
                await asyncio.sleep(0.01)
        made = Socket(reader, writer, system)
        self.clients.append(made)
        await until(lambda: made.messages)
        return made

    def commanded(self) -> FakeDrone:
        """Give the station control of drone 1."""
        self.drones[0].is_controlled = True
        return self.drones[0]

    def hear(self, state: State, drone: int = 1, age_ms: int | None = 100) -> None:
        self.station.heard.put_nowait(StateUpdate(1, drone, state, 1, age_ms))


def beats(client: Socket) -> list[int]:
    """The drones whose HEARTBEATs a client has heard."""
    return [message.get_srcSystem() for message in client.messages if message.get_type() == "HEARTBEAT"]


HEARTBEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
LAND = mavlink.MAVLink_command_long_message(1, 1, 21, 0, *[math.nan] * 7)
TAKEOFF = mavlink.MAVLink_command_long_message(1, 1, 22, 0, *[math.nan] * 7)
ARM = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1.0, *[0.0] * 6)


def suspend(monkeypatch: pytest.MonkeyPatch, seconds: int) -> None:
    """Suspend the machine, as far as its clocks show: only CLOCK_BOOTTIME goes on."""
    real, ahead_ns = time.clock_gettime_ns, {time.CLOCK_BOOTTIME: seconds * 10**9}
    monkeypatch.setattr(time, "clock_gettime_ns", lambda clock: real(clock) + ahead_ns.get(clock, 0))


async def flood(client: Socket) -> None:
    """Send so much that much is read at once, for 0.8 s."""
    for _ in range(40):
        client.say(*[HEARTBEAT] * 30)
        await asyncio.sleep(0.02)


def takeoff_altitude_of(drone: int) -> Any:
    """A question that is answered without asking the drone."""
    return mavlink.MAVLink_param_request_read_message(drone, 1, b"MIS_TAKEOFF_ALT", -1)


async def until(condition: Callable[[], Any]) -> None:
    async with asyncio.timeout(10):
        while not condition():
            await asyncio.sleep(0.01)


async def until_beats(client: Socket, drone: int, more: int) -> None:
    """Wait for more heartbeats of a drone."""
    beats = len(client.of("HEARTBEAT", drone))
    await until(lambda: len(client.of("HEARTBEAT", drone)) >= beats + more)


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    yield made
    for client in made.clients:
        await client.close()
    made.running.cancel()
    await asyncio.gather(made.running, return_exceptions=True)


async def test_every_client_is_shown_every_drone(bench: Bench) -> None:
    for client in (await bench.client(), await bench.client()):
        await until(lambda client=client: client.of("HEARTBEAT", 1) and client.of("GLOBAL_POSITION_INT", 2))


async def test_whoever_comes_hears_the_first_drone_first(bench: Bench) -> None:
    """pymavlink's own helpers, as mavset, command the vehicle whose HEARTBEAT they have heard first."""
    second = bench.drones.pop()
    bench.fog.drones.remove(second)
    watching = await bench.client()
    await until(lambda: watching.of("HEARTBEAT", 1))
    bench.fog.drones.insert(0, second)
    await until(lambda: watching.of("HEARTBEAT", 2))
    await until_beats(watching, 1, 1)
    late = await bench.client(254)
    await until(lambda: len(beats(late)) >= 4)
    assert beats(late)[:4] == [1, 2, 1, 2]


async def test_a_drone_that_is_silent_or_gone_or_does_not_say_what_it_is_is_not_shown(bench: Bench) -> None:
    client = await bench.client()
    first = bench.drones[0]

    async def shown() -> set[int]:
        """Who is shown while drone 2 beats twice, and what was under way before."""
        await until_beats(client, 2, 1)
        seen = len(client.messages)
        await until_beats(client, 2, 2)
        return {message.get_srcSystem() for message in client.messages[seen:]}

    first.age(SILENT_MS + 1)
    assert await shown() == {2}
    first.age(SILENT_MS)
    assert await shown() == {1, 2}
    first.is_reachable = False
    assert await shown() == {2}
    first.is_reachable = True
    airframe = first.states.pop(Airframe.name)
    assert await shown() == {2}
    first.states[Airframe.name] = airframe
    assert await shown() == {1, 2}
    del first.states[VelocityNed.name]
    first.age(STALE_MS + 1)
    assert await shown() == {2}, "it never had a position, and its autopilot is gone"
    first.age(STALE_MS)
    assert await shown() == {1, 2}


async def test_a_change_of_arming_is_shown_at_once(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    client = await bench.client()
    await until(lambda: client.of("HEARTBEAT"))
    monkeypatch.setitem(LOCAL, "HEARTBEAT", replace(LOCAL["HEARTBEAT"], rate_hz=0.001))
    await until_beats(client, 1, 1)  # the last one for a quarter of an hour
    beats, drone = len(client.of("HEARTBEAT")), bench.drones[0]
    drone.states["armed"] = KnownState(Armed(True), 0)
    bench.hear(Armed(True))
    await until(lambda: len(client.of("HEARTBEAT")) > beats)
    assert client.of("HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


async def test_texts_pass_as_they_come_and_old_ones_do_not(bench: Bench) -> None:
    client = await bench.client()
    for said, age_ms in (("old", 10_001), ("of unknown age", None), ("new", 900)):
        bench.hear(AutopilotText(Severity.CRITICAL, said), age_ms=age_ms)
    await until(lambda: client.of("STATUSTEXT"))
    assert [(text.severity, text.text) for text in client.of("STATUSTEXT")] == [(2, "new")]


async def test_a_message_of_the_drones_own_passes_but_for_those_that_are_made_here(bench: Bench) -> None:
    client = await bench.client()
    attitude = {"time_boot_ms": 7, "roll": 0.5, "pitch": None, "yaw": 0, "rollspeed": 0, "pitchspeed": 0, "yawspeed": 0}
    controls = {"time_usec": 1, "group_mlx": 0, "controls": (0.5, None, *[0.0] * 6)}
    bench.hear(MavlinkState("mavlink/HOME_POSITION", {}))
    ack = {"command": 400, "result": 0, "progress": 0, "result_param2": 0, "target_system": 0, "target_component": 0}
    value = {"param_id": "X", "param_value": 1.0, "param_type": 9, "param_count": 1, "param_index": 0}
    bench.hear(MavlinkState("mavlink/COMMAND_ACK", ack))
    bench.hear(MavlinkState("mavlink/PARAM_VALUE", value))
    bench.hear(MavlinkState("mavlink/ACTUATOR_CONTROL_TARGET", controls))
    bench.hear(MavlinkState("mavlink/ATTITUDE", attitude))
    bench.hear(MavlinkState("mavlink/STATUSTEXT", {"severity": 6, "text": "raw", "id": 0, "chunk_seq": 0}))
    bench.hear(Battery(50))
    await until(lambda: client.of("STATUSTEXT"))
    (passed,) = client.of("ATTITUDE")
    assert (passed.time_boot_ms, passed.roll, passed.pitch != passed.pitch) == (7, 0.5, True)
    assert client.of("ACTUATOR_CONTROL_TARGET")[0].controls[0] == 0.5
    assert client.of("HOME_POSITION") == []
    assert client.of("COMMAND_ACK") == client.of("PARAM_VALUE") == [], "no client has asked"


async def test_a_drone_with_the_id_of_a_client_is_hidden_from_it_alone(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    client, twin = await bench.client(), await bench.client(2)
    twin.say(HEARTBEAT, takeoff_altitude_of(2))
    await until(lambda: "drone 2 is not shown at tcp:" in caplog.text)
    seen = len(twin.messages)
    await until_beats(client, 2, 2)
    assert {message.get_srcSystem() for message in twin.messages[seen:]} == {1}
    assert twin.of("PARAM_VALUE", 2) == []
    assert caplog.text.count("drone 2 is not shown") == 1


@pytest.mark.parametrize(("system", "component", "answers"), [(1, 1, 1), (1, 0, 1), (1, 100, 0), (3, 1, 0), (0, 0, 0)])
async def test_only_what_is_for_a_drones_autopilot_is_answered(
    bench: Bench, system: int, component: int, answers: int
) -> None:
    client, other = await bench.client(), await bench.client()
    client.say(
        mavlink.MAVLink_command_long_message(system, component, 512, 0, 148, 0, 0, 0, 0, 0, 0),
        takeoff_altitude_of(2),
    )
    await until(lambda: client.of("PARAM_VALUE", 2))
    assert len(client.of("AUTOPILOT_VERSION")) == len(client.of("COMMAND_ACK")) == answers
    assert [message for message in other.messages if message.get_type() in ("PARAM_VALUE", "COMMAND_ACK")] == []


async def test_who_sends_no_heartbeat_is_told_so_and_commands_nothing(bench: Bench) -> None:
    client = await bench.client()
    client.say(ARM)
    await until(lambda: client.of("STATUSTEXT"))
    ack = client.of("COMMAND_ACK")[-1]
    assert (ack.result, ack.target_system, ack.target_component) == (mavlink.MAV_RESULT_DENIED, 255, 190)
    assert not bench.drones[0].wanted


async def test_what_waits_for_an_arm_ends_where_another_station_takes_the_drone(bench: Bench) -> None:
    client = await bench.client()
    client.say(HEARTBEAT, TAKEOFF)
    await until(lambda: [text for text in client.of("STATUSTEXT") if "waits" in text.text])
    bench.station.heard.put_nowait(ControlChanged(1, 1, "other", False, 1))
    await until(lambda: [text for text in client.of("STATUSTEXT") if text.text.startswith("takeoff given up")])
    assert not bench.drones[0].wanted


async def test_who_controls_a_drone_at_another_fog_is_of_no_consequence(bench: Bench) -> None:
    """The drone has gone from fog 2 to fog 1, where it is flown; fog 2 still has a record of it."""
    drone, client = bench.commanded(), await bench.client()
    client.say(HEARTBEAT, LAND)
    await until(lambda: drone.commands)
    bench.station.heard.put_nowait(ControlChanged(2, 1, "elsewhere", False, 1))
    bench.station.heard.put_nowait(ControlChanged(1, 1, "other", False, 1))
    await until(lambda: client.of("STATUSTEXT"))
    assert [text.text for text in client.of("STATUSTEXT")] == ["control was taken by the station other"]


async def test_the_outcome_that_follows_an_unconfirmed_one_is_a_text(bench: Bench) -> None:
    clients = await bench.client(), await bench.client(254)
    for word, settled in ((Word.UNCONFIRMED, False), (Word.COMPLETED, True)):
        bench.station.heard.put_nowait(Outcome(CommandId(1, 1), 1, 1, "land", word, settled=settled))
    for client in clients:
        await until(lambda client=client: client.of("STATUSTEXT"))
        assert [text.text for text in client.of("STATUSTEXT")] == ["land settled as completed"]


# A process that stood still


async def test_what_waited_while_the_machine_was_suspended_is_not_executed(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    drone, client = bench.commanded(), await bench.client()
    client.say(HEARTBEAT, LAND)
    suspend(monkeypatch, 2)
    await until(lambda: client.of("COMMAND_ACK"))
    assert (client.of("COMMAND_ACK")[0].result, drone.commands) == (mavlink.MAV_RESULT_TEMPORARILY_REJECTED, [])
    await asyncio.sleep(2 * standstill.DRAINING_MS / 1000)
    client.say(LAND)
    await until(lambda: [text for text in client.of("STATUSTEXT") if text.text.startswith("no HEARTBEAT")])
    assert drone.commands == [], "the HEARTBEAT of then does not count"
    client.say(HEARTBEAT, LAND)
    await until(lambda: drone.commands)


async def test_as_long_as_much_is_read_at_once_it_is_what_waited(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standstill, "DRAINING_MS", 400)
    drone, client = bench.commanded(), await bench.client()
    suspend(monkeypatch, 2)
    await flood(client)
    client.say(LAND)
    await until(lambda: client.of("COMMAND_ACK"))
    assert (client.of("COMMAND_ACK")[0].result, drone.commands) == (mavlink.MAV_RESULT_TEMPORARILY_REJECTED, [])


async def test_draining_ends_however_many_messages_arrive(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standstill, "DRAINING_MS", 200)
    monkeypatch.setattr(standstill, "LONGEST_DRAINING_MS", 200)
    drone, client = bench.commanded(), await bench.client()
    suspend(monkeypatch, 2)
    await flood(client)
    client.say(LAND)
    await flood(client)
    assert drone.commands == [Land()]


async def test_the_time_in_which_a_command_waited_while_the_machine_was_suspended_counts(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """R4.1: the gateway's clock goes on, that of the event loop does not."""
    monkeypatch.setattr(standstill, "DRAINING_MS", 0)
    drone, client = bench.commanded(), await bench.client()
    client.say(LAND)
    await asyncio.sleep(0.1)
    suspend(monkeypatch, 6)
    await asyncio.sleep(0.2)
    client.say(HEARTBEAT)
    await until(lambda: [ack for ack in client.of("COMMAND_ACK") if ack.result != mavlink.MAV_RESULT_IN_PROGRESS])
    assert (client.of("COMMAND_ACK")[-1].result, drone.commands) == (mavlink.MAV_RESULT_TEMPORARILY_REJECTED, [])
    client.say(LAND)
    await until(lambda: drone.commands)
    assert drone.commands == [Land()]


async def test_a_machine_that_was_suspended_flies_no_takeoff_of_before(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    drone, client = bench.commanded(), await bench.client()
    client.say(HEARTBEAT, TAKEOFF, ARM)
    await until(lambda: drone.commands)
    suspend(monkeypatch, 25)
    await until_beats(client, 1, 1)
    _, arm = drone.sent[0]
    arm.hear(Outcome(CommandId(1, 1), 1, 1, "arm", Word.COMPLETED))
    arm.end()

    def has_ended() -> bool:
        client.say(HEARTBEAT)
        return any("takeoff given up" in text.text for text in client.of("STATUSTEXT"))

    await until(has_ended)
    assert drone.commands == [Arm()]


async def test_what_clients_send_while_the_gateway_ends_is_not_handled(bench: Bench) -> None:
    drone = bench.commanded()
    await bench.client()
    bench.running.cancel()
    await asyncio.sleep(0)
    (peer,) = bench.gateway._endpoints.peers
    land = mavlink.MAVLink(None).decode(bytearray(LAND.pack(mavlink.MAVLink(None, 255, 190))))
    bench.gateway._on_message(peer, land)
    assert drone.commands == []


async def test_a_stations_end_is_the_gateways(bench: Bench) -> None:
    bench.station.heard.put_nowait(ControlChanged(1, 9, "other", False, 1))
    bench.station.heard.put_nowait(StationEnded("the broker has refused"))
    with pytest.raises(StationEnded, match="refused"):
        await bench.running
