"""STATUSTEXT to a client, a long text in several parts."""

from __future__ import annotations

import itertools

from pymavlink.dialects.v20 import common as mavlink

from ..protocol.states import Severity
from .endpoints import Peer

_PART = 50
_numbers = itertools.count(1)


def send_text(peer: Peer, drone: int, severity: Severity, text: str) -> None:
    """Send a text that a drone's client shows to people; its parts carry a common number, by which they are joined."""
    data = text.encode("ascii", "replace")
    if len(data) <= _PART:
        peer.send(drone, mavlink.MAVLink_statustext_message(severity, data, 0, 0))
        return
    number = next(_numbers) % 0xFFFF + 1
    parts = [data[at : at + _PART] for at in range(0, len(data) + 1, _PART)]
    for part_number, part in enumerate(parts):
        peer.send(drone, mavlink.MAVLink_statustext_message(severity, part, number, part_number))
