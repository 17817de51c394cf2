"""Objects that are carried in pieces between a station and a drone, named by their hash (docs/protocol.md, section 16).

The kind of an object only decides who interprets it: all kinds are carried alike.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from .fields import U32, VERSION, Binary, Hash, Integer, Items, Name, Reason, Session, Variant, Version

PIECE_BYTES = 512
WINDOW_BYTES = 1024
"""Bytes of objects that may be under way to or from a drone unanswered: a TCP stream has no priorities."""
MOST_BYTES = 1 << 20
"""Of an object in memory, which is any but a log."""
MOST_RANGES = 16

ObjectKind = Annotated[str, Name()]
_Size = Annotated[int, Integer(1, 2**32 - 1)]
_Data = Annotated[bytes, Binary(1, PIECE_BYTES)]


@dataclass(frozen=True)
class Range:
    """The bytes from `start` up to, and without, `end`."""

    start: U32
    end: U32


@dataclass(frozen=True)
class Put:
    """A piece of the object `hash` of `size` bytes, for the drone to keep."""

    hash: Hash
    size: Annotated[int, Integer(1, MOST_BYTES)]
    offset: U32
    data: _Data


@dataclass(frozen=True)
class Get:
    """Asks the drone for the `length` bytes from `offset` of the object `hash`; without one, which it has newest.

    `known` names what the station has already: the newest may be given as what has changed since then.
    """

    offset: U32
    length: Annotated[int, Integer(0, WINDOW_BYTES)]
    hash: Hash | None = None
    known: Hash | None = None


@dataclass(frozen=True)
class Have:
    """What the drone has of an object: all of it where the only range is the whole."""

    hash: Hash
    size: _Size
    ranges: Annotated[tuple[Range, ...], Items(MOST_RANGES)]


@dataclass(frozen=True)
class Piece:
    """A piece of the object `hash` of `size` bytes, from the drone."""

    hash: Hash
    size: _Size
    offset: U32
    data: _Data


@dataclass(frozen=True)
class Refused:
    """Why the drone does not keep, or give, an object."""

    reason: Reason
    hash: Hash | None = None


@dataclass(frozen=True)
class Unchanged:
    """What the station has already, `known`, is the newest."""

    known: Hash


@dataclass(frozen=True)
class Making:
    """The drone has `done` bytes of the `size` that it reads from its autopilot before it can give the object."""

    done: U32
    size: U32


ASK = Variant("ask", ((1, "put", Put), (2, "get", Get)))
Answer = Have | Piece | Refused | Unchanged | Making
ANSWER = Variant(
    "answer",
    (
        (1, "have", Have),
        (2, "piece", Piece),
        (3, "refused", Refused),
        (4, "unchanged", Unchanged),
        (5, "making", Making),
    ),
)


@dataclass(frozen=True, kw_only=True)
class BulkAsk:
    """What a station says of an object of a kind (`kind`), on `fogX/droneY/bulk` and `droneY/bulk`.

    `nonce` is the same in all that a station says of one transfer.
    """

    version: Version = VERSION
    gs_session: Session
    kind: ObjectKind
    nonce: U32
    ask: Annotated[Put | Get, ASK]


@dataclass(frozen=True, kw_only=True)
class BulkAnswer:
    """What the drone answers the station of a session, on `droneY/bulk_answer` and `fogX/droneY/bulk_answer`.

    `nonce` is that of what it answers.
    """

    version: Version = VERSION
    gs_session: Session
    kind: ObjectKind
    nonce: U32
    answer: Annotated[Answer, ANSWER]


class Partial:
    """An object that may be incomplete: the received bytes, and their ranges."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._data = bytearray(size)
        self.ranges: tuple[Range, ...] = ()

    @property
    def is_whole(self) -> bool:
        return self.ranges == (Range(0, self.size),)

    @property
    def data(self) -> bytes:
        return bytes(self._data)

    def put(self, offset: int, data: bytes) -> bool:
        """Take a piece in. Returns False, and takes nothing, if it lies outside or would make too many ranges."""
        end = offset + len(data)
        if end > self.size:
            return False
        joined = _joined([*self.ranges, Range(offset, end)])
        if len(joined) > MOST_RANGES:
            return False
        self._data[offset:end] = data
        self.ranges = joined
        return True

    def missing(self) -> list[Range]:
        """The missing ranges, in order."""
        ends = [0, *(has.end for has in self.ranges)]
        starts = [*(has.start for has in self.ranges), self.size]
        return [Range(start, end) for start, end in zip(ends, starts, strict=True) if start < end]


def _joined(ranges: Iterable[Range]) -> tuple[Range, ...]:
    """The ranges in order, with overlapping and adjacent ones joined."""
    out: list[Range] = []
    for each in sorted(ranges, key=lambda one: one.start):
        if out and each.start <= out[-1].end:
            out[-1] = Range(out[-1].start, max(out[-1].end, each.end))
        else:
            out.append(each)
    return tuple(out)
