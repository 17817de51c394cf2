"""Signed words of several drones in one message: each as its drone, or its activator, signed it."""

from __future__ import annotations

from collections.abc import Iterable

import cbor2

from ..errors import PayloadError
from ..protocol.cbor import parse_cbor
from ..protocol.fields import VERSION
from ..protocol.messages import MOST_TOGETHER
from ..protocol.names import MAX_DRONE
from .cose import Envelope


def encode_together(words: Iterable[tuple[int, Envelope]]) -> bytes:
    """`[1, [[drone, COSE_Sign1], …]]` in deterministic CBOR; only the envelopes are signed (R12.11)."""
    return cbor2.dumps([VERSION, [[drone, envelope.plain()] for drone, envelope in words]], canonical=True)


def parse_together(payload: bytes) -> list[tuple[int, Envelope]] | None:
    """Each drone's word, in order; None for a message that is signed as a whole. Raises PayloadError."""
    plain = parse_cbor(payload)
    if not isinstance(plain, list) or len(plain) != 2:
        return None
    version, rows = plain
    is_list = isinstance(rows, list) and 0 < len(rows) <= MOST_TOGETHER
    if type(version) is not int or version != VERSION or not is_list:
        raise PayloadError(f"words: expected [1, words] with 1 to {MOST_TOGETHER} words", "not_signed")
    found: list[tuple[int, Envelope]] = []
    for row in rows:
        if not (isinstance(row, list) and len(row) == 2 and type(row[0]) is int and 1 <= row[0] <= MAX_DRONE):
            raise PayloadError("words: expected each with its drone, as it was signed", "not_signed")
        found.append((row[0], Envelope.of_plain(row[1])))
    return found
