"""A member of the fleet that floods: `python -m tests.rigs.flooder IDENTITY PORT KIND READY_FILE`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from mqttxt.core.mqtt.tls import client_context
from mqttxt.protocol.cbor import MAX_PAYLOAD
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Hold
from mqttxt.protocol.control import Control, Registration
from mqttxt.protocol.messages import CommandMessage, Presence
from mqttxt.security.addressed import Addressed
from mqttxt.security.cose import Envelope
from mqttxt.security.identity import Identity
from mqttxt.security.seal import Seal

SESSION = 0xEEE
FEW = 100
"""Acknowledged messages after which it reports that it floods."""
PER_S = 1000
"""At most this many messages per second: far beyond a station's share (R15.4)."""
PER_VERIFIED = 8
"""A role reads one message in the time in which this many signatures are verified. If more arrive than it can read, its
broker drops others' messages, too."""
LONGEST = 10
"""The longest messages are sent less often by this factor."""
MEASURED_S = 0.5

Message = tuple[str, bytes]


class Flooder:
    """The endless messages that a station's identity can publish."""

    def __init__(self, seal: Seal) -> None:
        self.seal = seal

    def birth(self) -> Message:
        topic = f"gs/{self.seal.certificate.node.label}/reachable"
        presence = Presence(session=SESSION, up=True)
        return topic, self.seal.sign(topic, encode(presence), with_certificate=True).encode()

    def births(self) -> Iterator[Message]:
        birth = self.birth()
        return (birth for _ in count())

    def commands(self) -> Iterator[Message]:
        """Commands with new ids."""
        return (self._command(self._signed(seq)) for seq in count())

    def repetitions(self) -> Iterator[Message]:
        command = self._command(self._signed(1))
        return (command for _ in count())

    def forgeries(self) -> Iterator[Message]:
        command = self._command(replace(self._signed(1), signature=bytes(64)))
        return (command for _ in count())

    def garbage(self) -> Iterator[Message]:
        return (("fog1/commands", b"garbage") for _ in count())

    def longest(self) -> Iterator[Message]:
        return (("fog1/commands", bytes(MAX_PAYLOAD)) for _ in count())

    def questions(self) -> Iterator[Message]:
        """Registrations, each of which asks for a beacon."""
        return (self._question(nonce) for nonce in count())

    def _question(self, nonce: int) -> Message:
        name = self.seal.certificate.node.label
        asked = Registration(name=name, session=SESSION, nonce=nonce, lease_s=0, control=Control.NONE)
        return "fog1/init_connect", self.seal.sign("fog1/init_connect", encode(asked), True).encode()

    def _signed(self, seq: int) -> Envelope:
        command = CommandMessage(
            gs_session=SESSION, seq=seq, executor_session=7, deadline_ms=10**6, limit_s=9.0, command=Hold()
        )
        return self.seal.sign("drone1/commands", encode(command))

    def _command(self, envelope: Envelope) -> Message:
        return "fog1/drone1/commands", Addressed(9, 10**6, {1: envelope}).encode()


KINDS: dict[str, Callable[[Flooder], Iterator[Message]]] = {
    "births": Flooder.births,
    "commands": Flooder.commands,
    "repetitions": Flooder.repetitions,
    "forgeries": Flooder.forgeries,
    "garbage": Flooder.garbage,
    "longest": Flooder.longest,
    "questions": Flooder.questions,
}


def readable_per_s(flooder: Flooder) -> float:
    """How many messages per second a role can read on this machine under its present load, at most PER_S."""
    topic, payload = flooder.birth()
    began_s, verified = time.monotonic(), 0
    while time.monotonic() < began_s + MEASURED_S:
        flooder.seal.open(topic, payload, flooder.seal.name)
        verified += 1
    return min(PER_S, verified / MEASURED_S / PER_VERIFIED)


def main(folder: str, port: str, kind: str, ready_file: str) -> None:
    """Connect, publish a birth, and flood at QoS 1 until the process is ended."""
    identity = Identity.load(Path(folder))
    flooder = Flooder(Seal(identity))
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    client.tls_set_context(client_context(identity))
    client.connect("127.0.0.1", int(port))
    client.loop_start()
    topic, payload = flooder.birth()
    client.publish(topic, payload, 1, retain=True).wait_for_publish()
    acknowledged = count(1)
    client.on_publish = lambda *_: next(acknowledged) == FEW and Path(ready_file).touch()
    pause_s = (LONGEST if kind == "longest" else 1) / readable_per_s(flooder)
    due_s = time.monotonic()
    for topic, payload in KINDS[kind](flooder):
        client.publish(topic, payload, 1)
        due_s = max(due_s + pause_s, time.monotonic() - 1)  # a stall is not made up for
        time.sleep(max(0.0, due_s - time.monotonic()))


if __name__ == "__main__":
    main(*sys.argv[1:])
