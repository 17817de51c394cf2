"""Signed commands on their way to an activator: one envelope per drone, with the activator's deadline outside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import cbor2

from ..errors import PayloadError
from ..protocol.cbor import parse_cbor
from ..protocol.fields import VERSION
from ..protocol.names import MAX_DRONE
from .cose import Envelope

_MOST_U32, _MOST_MS = 2**32 - 1, 2**53 - 1


@dataclass(frozen=True)
class Addressed:
    """`[1, executor_session, deadline_ms, [[drone, COSE_Sign1], …]]`: session and deadline are the activator's.

    `reservation` follows if the command commits to the drone of an offer. Only the envelopes are signed: a relay can
    deliver a command earlier or never, but not later or elsewhere.
    """

    executor_session: int
    deadline_ms: int
    entries: dict[int, Envelope]
    reservation: int | None = None

    def encode(self) -> bytes:
        """The bytes on the wire: deterministic CBOR."""
        entries = [[drone, envelope.plain()] for drone, envelope in self.entries.items()]
        row: list[Any] = [VERSION, self.executor_session, self.deadline_ms, entries]
        return cbor2.dumps(row if self.reservation is None else [*row, self.reservation], canonical=True)

    @classmethod
    def parse(cls, data: bytes) -> Self:
        """Parse the bytes; raises PayloadError if they are anything else. No signature is verified."""
        plain = parse_cbor(data)
        if not isinstance(plain, list) or len(plain) not in (4, 5) or not isinstance(plain[3], list):
            raise PayloadError("command: expected [1, session, deadline, entries] around what is signed", "not_signed")
        version, session, deadline_ms, rows, reservation = plain if len(plain) == 5 else [*plain, None]
        numbers = ((version, VERSION, VERSION), (session, 0, _MOST_U32), (deadline_ms, 0, _MOST_MS))
        if not all(_is_number(*number) for number in numbers) or not (
            reservation is None or _is_number(reservation, 0, _MOST_U32)
        ):
            raise PayloadError("command: expected a session and a deadline of the activator", "not_signed")
        entries: dict[int, Envelope] = {}
        for row in rows[: MAX_DRONE + 1]:
            if not isinstance(row, list) or len(row) != 2 or not _is_number(row[0], 1, MAX_DRONE) or row[0] in entries:
                raise PayloadError("command: expected each drone once, with what is signed for it", "not_signed")
            entries[row[0]] = Envelope.of_plain(row[1])
        return cls(session, deadline_ms, entries, reservation)


def _is_number(plain: Any, low: int, high: int) -> bool:
    return type(plain) is int and low <= plain <= high
