"""Drones' words and answers as their activator passes them on, and their signers (docs/protocol.md, section 12)."""

from __future__ import annotations

from dataclasses import replace

from ..core.channel import Channel
from ..core.clock import STAMP_MODULUS
from ..core.effects import Inbound
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.messages import ResultMessage, Word
from ..protocol.topics import DroneTopic, FogSide, FogTopic
from ..protocol.values import shown
from ..security.cose import Envelope
from ..security.together import parse_together
from .fog import FogView

OF_A_FOG = frozenset({Word.DENIED, Word.EXPIRED, Word.UNREACHABLE, Word.UNCONFIRMED})
"""The words that an activator may say in its own name; all others are the drone's alone (R12.11)."""


class DroneWords:
    """Opens words and answers. Where messages are signed, raises PayloadError for one that its signer may not send."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel

    def answer(self, topic: DroneTopic, message: Inbound) -> bytes:
        """The payload of a drone's answer about an object; where messages are signed, of what the drone signed."""
        seal = self._channel.seal
        if seal is None:
            return message.payload
        return seal.open(FogSide().bulk_answer(topic.drone), message.payload, f"drone{topic.drone}").payload

    def result(self, fog: str, topic: DroneTopic, message: Inbound) -> tuple[ResultMessage, str | None]:
        """A word and its signer: the drone, or the activator of `fog` for its own word; None without signatures."""
        if self._channel.seal is None:
            return decode(ResultMessage, message.payload), None
        drone, own = f"drone{topic.drone}", FogSide().commands_result(topic.drone, topic.name)
        on_fogs = self._channel.signed_topic(message.topic)
        signed = self._channel.seal.open_one_of(message.payload, {drone: own, fog: on_fogs})
        result = decode(ResultMessage, signed.payload)
        if signed.signer == drone:
            return _relayed(result, signed.envelope), drone
        if result.word not in OF_A_FOG:
            raise PayloadError(f"{result.word.label} of {fog}: expected the drone to have signed it", "forged")
        return result, fog


def apart(fog: FogView, topic: FogTopic, message: Inbound) -> list[Inbound] | None:
    """A message of several signed words as one message per word; None for any other message (R12.11)."""
    found = parse_together(message.payload)
    if found is None:
        return None
    return [
        replace(message, topic=fog.topics.drone_result(drone, topic.name), payload=envelope.encode())
        for drone, envelope in found
    ]


def _relayed(result: ResultMessage, signed: Envelope) -> ResultMessage:
    """A drone's word with its activator's additions: the relay stamp, and whether it settles an `unconfirmed`."""
    route = signed.route
    if not (isinstance(route, list) and len(route) == 2 and type(route[1]) is bool):
        raise PayloadError(f"route {shown(route)}: expected a stamp and whether it settles")
    if not (route[0] is None or (type(route[0]) is int and 0 <= route[0] < STAMP_MODULUS)):
        raise PayloadError(f"route {shown(route)}: expected a stamp")
    return replace(result, relay_stamp=route[0], settled=route[1] or None)
