"""Two attempts of the message set made by hand: ten kinds, two of each, a second apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm, Command, Goto, Land, Offboard, Stream, Takeoff, Velocity
from mqttxt.protocol.messages import CommandMessage
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import Battery, FlightMode, FlightModeName, Groundspeed, Heading, Location, State
from mqttxt.protocol.values import Encoding
from testbed.fly.results import Attempt, Series, new_attempt, write_json
from tests.handmade.attempts import NODES, SECOND, T0, frame, manifest, publish, write_captures, write_lines
from tests.handmade.mavlink_attempts import (
    MS,
    Chain,
    long_command,
    make_mavlink_attempt,
    packed,
    sender,
    stream_message,
)

COMMANDS = ("arm", "takeoff", "land", "offboard", "goto")
STATES = ("battery", "location", "groundspeed", "flight_mode", "heading")
COUNT = 2
KIND_S = 10
"""From the beginning of a kind to that of the next."""
ANSWERED_MS = 12
"""From a call to its first word."""
_CARRIER = {
    **{"battery": "BATTERY_STATUS", "location": "GLOBAL_POSITION_INT", "groundspeed": "VFR_HUD"},
    **{"flight_mode": "HEARTBEAT", "heading": "GLOBAL_POSITION_INT"},
}
_NUMBERS = {"arm": 400, "takeoff": 22, "land": 21, "offboard": 176}


def start_of(name: str) -> int:
    """When a kind begins."""
    return T0 + (*COMMANDS, *STATES).index(name) * KIND_S * SECOND


def call_times(name: str) -> list[int]:
    """When each of a kind's calls is made, or each value of a state leaves its drone."""
    return [start_of(name) + (number + 1) * SECOND for number in range(COUNT)]


def message_events(
    refused: tuple[str, ...] = (),
    silent: tuple[str, ...] = (),
    unsent: tuple[str, ...] = (),
    age_ms: int | None = None,
) -> list[dict[str, Any]]:
    """The events that the mission writes; the values that it receives are `age_ms` old.

    The second call of a kind in `refused` is denied, that of one in `silent` gets no answer;
    a state in `silent` lacks its second value. A kind in `unsent` has a third call, of which no frame is sent.
    """
    events: list[dict[str, Any]] = [
        {"t_ns": T0 - SECOND, "event": "mission_start", "scenario": "messages", "drones": [1]}
    ]
    call = 0
    for name in (*COMMANDS, *STATES):
        form = "command" if name in COMMANDS else "state"
        done = 0
        events.append({"t_ns": start_of(name), "event": "kind", "name": name, "form": form, "count": COUNT})
        for number, t_ns in enumerate(call_times(name), 1):
            if form == "state":
                if number == 1 or name not in silent:
                    done += 1
                    came = {"event": "value", "name": name, "number": number, "value": 1.0, "age_ms": age_ms}
                    events.append({"t_ns": t_ns + 3 * MS, **came})
                continue
            call += 1
            about = {"call": call, "command": name, "fog": 1, "drone": 1}
            events.append({"t_ns": t_ns - 100 * MS, "event": "reset", "call": call})
            events.append({"t_ns": t_ns - 1000, "event": "command", **about})
            if number == COUNT and name in silent:
                continue
            denied = number == COUNT and name in refused
            word = {"word": "denied", "reason": "not now"} if denied else {"word": "accepted", "reason": None}
            done += not denied
            heard = {"event": "outcome", **about, "id": f"7:{call}", **word, "final": denied}
            events.append({"t_ns": t_ns + ANSWERED_MS * MS, **heard})
            if not denied:
                events.append({"t_ns": t_ns + 50 * MS, **heard, "word": "completed", "final": True})
        if name in unsent:
            call += 1
            about = {"call": call, "command": name, "fog": 1, "drone": 1}
            given_up = {"id": f"7:{call}", "word": "unconfirmed", "reason": "timeout", "final": True}
            events.append({"t_ns": start_of(name) + 3 * SECOND, "event": "command", **about})
            events.append({"t_ns": start_of(name) + 3 * SECOND + 900 * MS, "event": "outcome", **about, **given_up})
        ended = {"event": "kind_done", "name": name, "received": done, "missing": COUNT - done}
        events.append({"t_ns": start_of(name) + 4 * SECOND, **ended})
    end_ns = start_of(STATES[-1]) + 5 * SECOND
    return [*events, {"t_ns": end_ns, "event": "mission_end", "status": "completed", "reason": None}]


def make_mavlink_messages(series: Series, number: int = 1, **events: Any) -> Attempt:
    """Each call sends its command, 3 hops, answered by an ACK; attitudes stream at 4 Hz all the time.

    The second `takeoff` is sent three times: the first two are lost on the air link. Each call of `offboard` is sent
    with a set-point. The second battery status is lost on the wan link. Each state is requested first.
    """
    said: list[tuple[int, bool, Any, str | None]] = []
    """Time, whether up, message, and the node before which a link loses it."""
    for name in COMMANDS:
        for place, t_ns in enumerate(call_times(name)):
            if name == "goto":
                args = (0, 0, -1.0, 1.0, 0.0, 0.0, 473977000, 85455000, 500.0)
                message = common.MAVLink_command_int_message(1, 1, 6, 192, *args)
            else:
                message = long_command(_NUMBERS[name], 1, *{"arm": (1.0,), "offboard": (1.0, 6.0)}.get(name, ()))
            if name == "offboard":
                target = common.MAVLink_set_position_target_local_ned_message(1, 1, 1, 1, 0, *[0.0] * 11)
                said.append((t_ns + MS // 4, False, target, None))
            again = name == "takeoff" and place == 1
            said += [(t_ns + after, False, message, "uav1") for after in (0, 2 * MS) if again]
            said.append((t_ns + 4 * MS * again, False, message, None))
            ack = common.MAVLink_command_ack_message(_NUMBERS.get(name, 192), 0, 0, 0, 245, 190)
            said.append((t_ns + 8 * MS, True, ack, None))
    for name in STATES:
        number_of = {known.msgname: identity for identity, known in common.mavlink_map.items()}
        said.append((start_of(name) + MS, False, long_command(511, 1, float(number_of[_CARRIER[name]]), 1e6), None))
        answer = common.MAVLink_command_ack_message(511, 0, 0, 0, 245, 190)
        said.append((start_of(name) + 5 * MS, True, answer, None))
        for place, t_ns in enumerate(call_times(name)):
            lost = "gs" if name == "battery" and place == 1 else None
            said.append((t_ns, True, stream_message(_CARRIER[name], t_ns // MS % 1000), lost))
    end_s = (start_of(STATES[-1]) - T0) // SECOND + 5
    said += [(T0 + n * SECOND // 4 + 3 * MS, True, stream_message("ATTITUDE", n), None) for n in range(4 * end_s)]
    chain, drone, station = Chain(), sender(1), sender(245, 190)
    for t_ns, up, message, lost in sorted(said, key=lambda one: one[0]):
        chain.send(t_ns, packed(drone if up else station, message), 1, up=up, lost_on=lost)
    return make_mavlink_attempt(series, number, chain, message_events(**events), end_s, experiment="messages")


@dataclass
class Wire:
    """MQTT over TCP between neighbours, each frame acknowledged by a bare one; a frame leaves its link after MS/2."""

    captures: dict[str, list[tuple[int, bytes]]] = field(default_factory=lambda: {node: [] for node in NODES})
    sequence: dict[tuple[str, str], int] = field(default_factory=dict)
    identity: int = 0

    def segment(self, t_ns: int, here: str, there: str, body: bytes, again: bool = False, lost: bool = False) -> None:
        """Send a frame into the link; `again` repeats the bytes that were sent last."""
        self.identity += 1
        at = self.sequence.get((here, there), 1000)
        start = at - len(body) if again else at
        data = frame(here, there, body, self.identity, _PORTS[here, there], start)
        self.sequence[here, there] = start + len(body)
        self.captures[here].append((t_ns, data))
        if not lost:
            self.captures[there].append((t_ns + MS // 2, data))

    def carry(self, t_ns: int, here: str, there: str, body: bytes, **how: Any) -> None:
        """Send a frame, and the bare acknowledgement that answers it."""
        self.segment(t_ns, here, there, body, **how)
        if not how.get("lost"):
            self.segment(t_ns + MS // 2 + MS // 10, there, here, b"")

    def down(self, t_ns: int, payload: bytes, lost: bool = False) -> None:
        self.carry(t_ns, "gs", "cloud", publish("fog1/drone1/commands", payload))
        self.carry(t_ns + MS, "cloud", "fog1", publish("fog1/drone1/commands", payload))
        self.carry(t_ns + 2 * MS, "fog1", "uav1", publish("drone1/commands", payload), lost=lost)

    def up(self, t_ns: int, topic: str, payload: bytes, relayed: bytes | None = None, lost: bool = False) -> None:
        """Carry it to the ground station, unless it is lost between fog and cloud."""
        self.carry(t_ns, "uav1", "fog1", publish(f"drone1/{topic}", payload))
        self.carry(t_ns + MS, "fog1", "cloud", publish(f"fog1/drone1/{topic}", relayed or payload), lost=lost)
        if not lost:
            self.carry(t_ns + 2 * MS, "cloud", "gs", publish(f"fog1/drone1/{topic}", relayed or payload))


_PORTS = {
    **{("gs", "cloud"): (40_000, 1883), ("cloud", "gs"): (1883, 40_000)},
    **{("fog1", "cloud"): (40_001, 1883), ("cloud", "fog1"): (1883, 40_001)},
    **{("uav1", "fog1"): (40_002, 1883), ("fog1", "uav1"): (1883, 40_002)},
}


def make_mqttxt_messages(series: Series, number: int = 1, **events: Any) -> Attempt:
    """Each call publishes its command over three hops, answered by `accepted`, and 40 ms later by `completed`.

    A battery state is sent 2 ms after each call of `arm`. The second `goto` is lost on the air link and repeated by
    TCP 2 ms later. The second heading is lost between fog and cloud. Each state is requested by `stream` first.
    """
    wire, seq = Wire(), 0

    def command(body: Command) -> bytes:
        nonlocal seq
        seq += 1
        return encode(
            CommandMessage(gs_session=7, seq=seq, executor_session=9, deadline_ms=5000, limit_s=10.0, command=body)
        )

    for name in COMMANDS:
        for place, t_ns in enumerate(call_times(name)):
            payload = command(_BODIES[name])
            is_lost = name == "goto" and place == 1
            wire.down(t_ns, payload, is_lost)
            if is_lost:
                wire.carry(t_ns + 4 * MS, "fog1", "uav1", publish("drone1/commands", payload), again=True)
            if name == "arm":
                _state(wire, t_ns + 2 * MS, Battery(90), place)
            wire.up(t_ns + 6 * MS, f"commands_result/{name}", b"\x01")
            wire.up(t_ns + 45 * MS, f"commands_result/{name}", b"\x02")
    for name in STATES:
        wire.down(start_of(name) + MS, command(Stream(name, 1.0)))
        wire.up(start_of(name) + 7 * MS, "commands_result/stream", b"\x01")
        for place, t_ns in enumerate(call_times(name)):
            _state(wire, t_ns, _VALUES[name], 100 + 7 * t_ns // SECOND % 60_000, lost=name == "heading" and place == 1)
    attempt = new_attempt(series, "mqttxt", number)
    told = manifest(experiment="messages", protocol="mqttxt", cpu_s={"gs": 0.5, "client1": 0.4})
    write_json(attempt.path / "manifest.json", told)
    write_captures(attempt, wire.captures)
    write_lines(attempt.path / "events.jsonl", message_events(**events, age_ms=3))
    write_lines(attempt.path / "sitl" / "uav1.jsonl", [{"t_ns": T0 + SECOND, "event": "disarmed"}])
    return attempt


def _state(wire: Wire, t_ns: int, value: State, stamp: int, lost: bool = False) -> None:
    body = encode_state(StampedState(value, stamp), Encoding.CBOR)
    relayed = encode_state(StampedState(value, stamp, relay_stamp=5), Encoding.CBOR)
    wire.up(t_ns, f"state/{value.name}", body, relayed, lost)


_BODIES: dict[str, Command] = {
    **{"arm": Arm(), "takeoff": Takeoff(), "land": Land(), "goto": Goto(47.39, 8.54, 10.0)},
    **{"offboard": Offboard(5.0, velocity=Velocity(1.0, 0.0, 0.0))},
}
_VALUES: dict[str, State] = {
    **{"battery": Battery(90), "location": Location(47.39, 8.54, 498.0, 10.0), "heading": Heading(90.0)},
    **{"groundspeed": Groundspeed(1.0), "flight_mode": FlightMode(FlightModeName.HOLD)},
}
