"""Messages as on the wire, byte by byte, for authors of other implementations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cbor2

from mqttxt.protocol.bundles import drone_bundle, fog_bundles
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Takeoff
from mqttxt.protocol.messages import BeaconMessage, CommandMessage, FogResultMessage, ResultMessage, Word, WordTogether
from mqttxt.protocol.readings import ReadingAck, ReadingKey, ReadingMessage
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import Battery, Heading, Location
from mqttxt.protocol.values import Encoding

STATION, FOG, DRONE = 0x0A11CE, 0xF061, 0xD203E
"""Sessions; real ones are random and mostly take four bytes."""


@dataclass(frozen=True)
class Example:
    """One message with its topic, in CBOR and in JSON."""

    title: str
    topic: str
    cbor: bytes
    json: bytes

    @property
    def diagnostic(self) -> str:
        """The CBOR in diagnostic notation (RFC 8949, section 8)."""
        return notation(cbor2.loads(self.cbor))


def notation(plain: Any) -> str:
    """A decoded payload in CBOR's diagnostic notation."""
    if isinstance(plain, list):
        return "[" + ", ".join(notation(item) for item in plain) + "]"
    if isinstance(plain, str):
        return '"' + plain.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if plain is None:
        return "null"
    return str(plain).lower() if isinstance(plain, bool) else str(plain)


def examples() -> list[Example]:
    """A beacon, a command and its forwarding, its words, a state on both sides, and bundles."""
    command = CommandMessage(
        gs_session=STATION,
        seq=7,
        executor_session=FOG,
        deadline_ms=86_400,
        limit_s=120.0,
        command=Takeoff(altitude_m=10.0),
    )
    forwarded = CommandMessage(
        gs_session=STATION,
        seq=7,
        executor_session=DRONE,
        deadline_ms=41_230,
        limit_s=120.0,
        command=Takeoff(altitude_m=10.0),
    )
    said = ResultMessage(gs_session=STATION, seq=7, session=DRONE, stamp=4090, word=Word.COMPLETED)
    denied = ResultMessage(
        gs_session=STATION, seq=8, session=FOG, relay_stamp=8190, stamp=8190, word=Word.DENIED, reason="retained"
    )
    together = FogResultMessage(
        gs_session=STATION,
        seq=7,
        session=FOG,
        stamp=8203,
        words=tuple(
            WordTogether(drone=drone, session=session, relay_stamp=came, stamp=own, word=Word.ACCEPTED)
            for drone, session, came, own in ((2, DRONE, 8194, 4088), (3, 0xD303E, 8201, 17))
        ),
    )
    beacon = BeaconMessage(session=FOG, now_ms=81_405, nonce=3_735_928_559, held_ms=2)
    place = Location(latitude_deg=47.397742, longitude_deg=8.545594, altitude_amsl_m=498.0, altitude_m=10.0)
    newer = StampedState(Heading(heading_deg=271.5), 4101, 8201)
    (bundle,) = fog_bundles(
        [(2, StampedState(place, 4090, 8190)), (2, newer), (3, StampedState(Battery(64), 17, 8204))]
    )
    reading = ReadingMessage(boot=0xB007, seq=12, time_ms=1_767_225_600_000, value=21.5)
    stored = ReadingAck(readings=(ReadingKey(sensor=3, boot=0xB007, seq=12),))
    return [
        _message("An activator's beacon that echoes a station's nonce", "fog1/clock", beacon),
        _message("A station's command, due in the activator's clock", "fog1/drone2/commands", command),
        _message("The same, forwarded and due in the drone's clock", "drone2/commands", forwarded),
        _message("The drone's last word about it", "drone2/commands_result/takeoff", said),
        _message("Words of two drones about a broadcast in one message", "fog1/commands_result/takeoff", together),
        _message("A last word of the activator's own", "fog1/drone2/commands_result/arm", denied),
        _state("A position from the drone", "drone2/state/location", StampedState(place, 4090)),
        _state("The same position, relayed", "fog1/drone2/state/location", StampedState(place, 4090, 8190)),
        _message("Two states of a drone in one message", "drone2/states", drone_bundle([place, Battery(87)], 4090)),
        _message("States of two drones in one message", "fog1/states", bundle),
        _message("A temperature that a drone carried", "fog1/drone2/sensor3/temperature", reading),
        _message("The activator has passed it on", "drone2/sensor_ack", stored),
    ]


def _message(title: str, topic: str, message: Any) -> Example:
    return Example(title, topic, encode(message), encode(message, Encoding.JSON))


def _state(title: str, topic: str, state: StampedState) -> Example:
    return Example(title, topic, encode_state(state, Encoding.CBOR), encode_state(state, Encoding.JSON))
