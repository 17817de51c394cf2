"""Unchanged MAVLink messages as states: every message of common.xml, by pymavlink's own tables."""

from __future__ import annotations

import math
from functools import cache
from typing import Annotated, Any, cast

from .fields import FLOAT32_MAX, Integer, Items, Real, Text
from .states import FieldValue, MavlinkState
from .topics import MAVLINK_STATE

_SMALLEST = {"int8_t": -(2**7), "int16_t": -(2**15), "int32_t": -(2**31), "int64_t": -(2**63)}
_LARGEST_DOUBLE = 1.7976931348623157e308


@cache
def kinds() -> dict[str, Any]:
    """pymavlink's class of each message, by its name in common.xml. Imported late: most stations never receive one."""
    from pymavlink.dialects.v20 import common as mavlink

    return {kind.msgname: kind for kind in mavlink.mavlink_map.values()}


def kind_of(name: str) -> Any | None:
    """The class of the message in state `mavlink/NAME`, None for any other name."""
    return kinds().get(name.removeprefix(MAVLINK_STATE)) if name.startswith(MAVLINK_STATE) else None


@cache
def fields_of(name: str) -> tuple[tuple[str, Any], ...]:
    """The fields of state `mavlink/NAME` in the order of common.xml, each with its annotated type."""
    kind = kind_of(name)
    assert kind is not None
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    return tuple(
        (field, _hint(type_name, lengths[field]))
        for field, type_name in zip(kind.fieldnames, kind.fieldtypes, strict=True)
    )


def state_of(message: Any) -> MavlinkState:
    """A received message as a state; NaN and infinite floats become None."""
    values = {field: _value(getattr(message, field)) for field in message.fieldnames}
    return MavlinkState(MAVLINK_STATE + message.get_type(), values)


def _hint(type_name: str, length: int) -> Any:
    if type_name == "char":
        return Annotated[str, Text(max(1, length))]
    one: Any
    if type_name in ("float", "double"):
        one = Annotated[float | None, Real(FLOAT32_MAX if type_name == "float" else _LARGEST_DOUBLE)]
    else:
        bits = int("".join(c for c in type_name if c.isdigit()))
        low = _SMALLEST.get(type_name, 0)
        one = Annotated[int, Integer(low, 2 ** (bits - 1) - 1 if low else 2**bits - 1)]
    return Annotated[tuple[one, ...], Items(length, least=length)] if length else one


def _value(value: Any) -> FieldValue:
    if isinstance(value, list | tuple):
        return tuple(cast("float | int | None", _value(item)) for item in value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return cast(FieldValue, value)
