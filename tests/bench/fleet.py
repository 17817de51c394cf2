"""Drones that exist only as messages: any number of them at one fog broker, over one connection."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping

from mqttxt.protocol.bundles import drone_bundle
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import DroneLease
from mqttxt.protocol.messages import BeaconMessage, Presence
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import (
    Battery,
    FlightMode,
    FlightModeName,
    Groundspeed,
    Heading,
    Location,
    MaxGroundspeed,
    State,
)
from mqttxt.protocol.topics import FogSide
from mqttxt.protocol.values import Encoding
from mqttxt.security.cose import Envelope
from mqttxt.security.seal import Seal
from tests.bench.raw_mqtt import RawClient, with_alias

FIVE: tuple[State, ...] = (
    Battery(87),
    Location(47.3980, 8.5460, 503.2, 15.2),
    Heading(123.45),
    Groundspeed(11.87),
    FlightMode(FlightModeName.MISSION),
)
"""The five vital states, with values as in flight."""
_FIRST_STAMP = 256
"""The lowest that CBOR writes in three bytes."""


class Fleet:
    """`numbers` drones below `root` and their five states; with `seals`, by number, they sign, at fog 1."""

    def __init__(
        self,
        port: int,
        numbers: range,
        root: str = "",
        bundles: bool = False,
        seals: Mapping[int, Seal] | None = None,
    ) -> None:
        self._seals = seals or {}
        self.sent = 0
        self._bundles = bundles
        self._port = port
        self._topics = FogSide(root)
        self._sessions = {number: 0x10000 + number for number in numbers}
        self._born_s = time.monotonic()
        self._packets: list[tuple[bytes, bytes]] = []
        self._client: RawClient | None = None

    async def start(self) -> None:
        """Connect, publish births, answer leases; then send each state once in full, which sets its alias."""
        client = self._client = await RawClient.connect(self._port, f"fleet-{self._topics.root}", self._on_lease)
        await client.subscribe(f"{self._topics.root}+/init_connect", qos=1)
        for number, session in self._sessions.items():
            birth = encode(Presence(session=session, up=True))
            self._say(number, self._topics.reachable(number), birth, qos=1, with_certificate=True)
            await asyncio.sleep(0)
            fastest = encode_state(StampedState(MaxGroundspeed(12.0), _FIRST_STAMP), Encoding.CBOR)
            client.publish(self._topics.state(number, MaxGroundspeed.name), fastest)
        alias = 0
        for number in self._sessions:
            for topic, payload in self._said(number):
                alias += 1
                client.send(with_alias(topic, payload, alias))
                short = with_alias("", payload, alias)
                cut = len(short) - len(payload) + payload.index(b"\x19\x01\x00") + 1
                self._packets.append((short[:cut], short[cut + 2 :]))

    def _said(self, number: int) -> list[tuple[str, bytes]]:
        """Topics and payloads of a drone's five states."""
        if self._bundles:
            return [(self._topics.states(number), encode(drone_bundle(FIVE, _FIRST_STAMP)))]
        return [
            (self._topics.state(number, state.name), encode_state(StampedState(state, _FIRST_STAMP), Encoding.CBOR))
            for state in FIVE
        ]

    def __len__(self) -> int:
        return len(self._sessions)

    def send_part(self, part: int, parts: int) -> None:
        """Send those of the drones' states that are due in one of `parts` equal slices of their interval."""
        assert self._client is not None
        now = self.stamp().to_bytes(2, "big")
        packets = self._packets[part::parts]
        self._client.send(b"".join(head + now + tail for head, tail in packets))
        self.sent += len(packets) * (len(FIVE) if self._bundles else 1)

    def _say(
        self, number: int, topic: str, payload: bytes, qos: int = 0, with_certificate: bool = False, fog: str = ""
    ) -> None:
        assert self._client is not None
        seal = self._seals.get(number)
        if seal is not None:
            payload = seal.sign(fog + topic.removeprefix(self._topics.root), payload, with_certificate).encode()
        self._client.publish(topic, payload, qos)

    def stamp(self) -> int:
        """The present stamp, kept to values that take three bytes of CBOR."""
        return max(256, int((time.monotonic() - self._born_s) * 100) + 256) % 65_536

    def close(self) -> None:
        assert self._client is not None
        self._client.close()

    def _on_lease(self, topic: str, payload: bytes) -> None:
        number = self._topics.parse(topic).drone
        lease = decode(DroneLease, Envelope.parse(payload).payload if self._seals else payload)
        now_ms = int((time.monotonic() - self._born_s) * 1000) + 2560
        beacon = BeaconMessage(session=self._sessions[number], now_ms=now_ms, nonce=lease.nonce, held_ms=0)
        self._say(number, self._topics.clock(number), encode(beacon), fog="fog1/")
