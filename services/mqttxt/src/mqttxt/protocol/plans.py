"""A plan on the wire: mission, geofence and rally points as lists of MAVLink's items, and the hash of each list."""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

from .codec import encode
from .commands import CommandParameter
from .fields import HASH_BYTES, U16, VERSION, Integer, Items, Named, Version
from .packing import pack, unpack

PLAN = "plan"
"""The kind of a plan among the objects that are carried in pieces."""
MOST_ITEMS = 2000
_Coordinate = Annotated[int, Integer(-(2**31), 2**31 - 1)]


class PlanList(Named):
    """The three lists of a plan (MAV_MISSION_TYPE)."""

    MISSION = 0
    FENCE = 1
    RALLY = 2


@dataclass(frozen=True)
class PlanItem:
    """One item, field by field a MISSION_ITEM_INT: `x` and `y` in degrees times 1e7 where `frame` is on the globe.

    Its numbers are rounded to MAVLink's floats of 32 bits, NaN being None, so that equal items compare equal.
    """

    frame: Annotated[int, Integer(0, 255)]
    command: U16
    params: Annotated[tuple[CommandParameter, ...], Items(4, least=4)]
    x: _Coordinate
    y: _Coordinate
    z: CommandParameter
    autocontinue: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "params", tuple(single(param) for param in self.params))
        object.__setattr__(self, "z", single(self.z))


PlanItems = Annotated[tuple[PlanItem, ...], Items(MOST_ITEMS)]


@dataclass(frozen=True, kw_only=True)
class PlanObject:
    """A plan as it is carried: each list that is there replaces the drone's, an empty one clears it.

    A list that is absent is left as it is. The object travels compressed (RFC 1950).
    """

    version: Version = VERSION
    mission: PlanItems | None = None
    fence: PlanItems | None = None
    rally: PlanItems | None = None

    @property
    def lists(self) -> dict[PlanList, tuple[PlanItem, ...]]:
        """The lists that the object has."""
        found = {PlanList.MISSION: self.mission, PlanList.FENCE: self.fence, PlanList.RALLY: self.rally}
        return {kind: items for kind, items in found.items() if items is not None}

    @classmethod
    def of(cls, lists: Mapping[PlanList, tuple[PlanItem, ...]]) -> PlanObject:
        """The object with these lists; others are absent."""
        kinds = (PlanList.MISSION, PlanList.FENCE, PlanList.RALLY)
        mission, fence, rally = (lists.get(kind) for kind in kinds)
        return cls(mission=mission, fence=fence, rally=rally)

    def packed(self) -> bytes:
        """The bytes of the object. Raises PayloadError for a field that cannot be carried, and for too long a plan."""
        return pack(self, PLAN)

    @classmethod
    def unpacked(cls, data: bytes) -> PlanObject:
        """The object from its bytes. Raises PayloadError."""
        return unpack(cls, data, PLAN)


def hash_of(data: bytes) -> bytes:
    """The hash that names an object that is carried in pieces."""
    return hashlib.sha256(data).digest()[:HASH_BYTES]


@dataclass(frozen=True, kw_only=True)
class _Listed:
    items: PlanItems


def list_hash(items: Iterable[PlanItem]) -> bytes:
    """The hash that names a list, of its items in CBOR."""
    return hash_of(encode(_Listed(items=tuple(items))))


def single(value: float | None) -> float | None:
    """A float rounded to 32 bits, None for NaN; one that is too large is left for the codec to refuse."""
    if value is None or math.isnan(value):
        return None
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return value
