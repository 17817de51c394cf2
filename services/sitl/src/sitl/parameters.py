"""Parameters with their types, ranges and defaults, and MAVLink's ways to encode them."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .errors import SitlError

HASH, NO_INDEX = "_HASH_CHECK", 2**16 - 1
TYPE_MISMATCH = 7
"""A MAV_PARAM_ERROR that pymavlink does not have yet."""
INT32, REAL32 = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32


@dataclass(frozen=True)
class Spec:
    """A parameter's default and range; an int default makes it an INT32 parameter, else it is REAL32."""

    default: float | int
    low: float
    high: float


class Parameters:
    """The parameters of one autopilot, in the order of their indices; integers are sent as floats."""

    def __init__(self, specs: Mapping[str, Spec], overrides: Mapping[str, float] | None = None) -> None:
        self._specs = specs
        self._names = list(specs)
        self._values = {name: spec.default for name, spec in specs.items()}
        for name, value in (overrides or {}).items():
            if not self.set(name, value):
                spec = specs[name]
                raise SitlError(f"parameter {name}: expected {spec.low:g} to {spec.high:g}, got {value:g}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def set(self, name: str, value: float) -> bool:
        """Set a parameter; an unknown name, NaN or a value out of range changes nothing and returns False."""
        spec = self._specs.get(name)
        if spec is None or not spec.low <= value <= spec.high:
            return False
        self._values[name] = int(value) if isinstance(spec.default, int) else float(value)
        return True

    def message(self, name: str) -> Any:
        """PARAM_VALUE with the parameter's index in the list."""
        return self._value(name, self._names.index(name))

    def _value(self, name: str, index: int) -> Any:
        value = self._values[name]
        kind = INT32 if isinstance(value, int) else REAL32
        return self._told(name, self._encoded(value), kind, index)

    def _told(self, name: str, carried: float, kind: int, index: int) -> Any:
        return mavlink.MAVLink_param_value_message(name.encode(), carried, kind, len(self._names), index)

    def on_message(self, message: Any) -> list[Any]:
        """Answers to PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return self._list()
        if kind == "PARAM_SET":
            return self._set(message)
        if message.param_index >= 0:
            name = next(iter(self._names[message.param_index : message.param_index + 1]), "")
        else:
            name = str(message.param_id)
        if name not in self._values:
            return self._unknown(message)
        return [self.message(name) if message.param_index >= 0 else self._named(name)]

    def _list(self) -> list[Any]:
        return [self.message(name) for name in self._names]

    def _set(self, message: Any) -> list[Any]:
        """Take a value of any type as a number; the answer has no index."""
        name, value = str(message.param_id), float(message.param_value)
        if name not in self._values or not math.isfinite(value):
            return []
        self.set(name, value)
        return [self._value(name, NO_INDEX)]

    def _named(self, name: str) -> Any:
        """The answer to a request by name, which has no index."""
        return self._value(name, NO_INDEX)

    def _unknown(self, message: Any) -> list[Any]:
        """The answers to a request for an unknown parameter."""
        return []

    def _encoded(self, value: float) -> float:
        """A value as encoded in PARAM_VALUE."""
        return float(value)


class BytewiseParameters(Parameters):
    """Integers are sent and set as their bytes in the float's place; a hash covers all values.

    A wrong name or type is answered with PARAM_ERROR, a value out of range with the value that stays.
    """

    def _list(self) -> list[Any]:
        return [self._hash(), *super()._list()]

    def on_message(self, message: Any) -> list[Any]:
        if message.get_type() == "PARAM_REQUEST_READ" and str(message.param_id) == HASH:
            return [self._hash()]
        return super().on_message(message)

    def _hash(self) -> Any:
        crc = 0
        for name in sorted(self._names):
            value = self._values[name]
            packed = struct.pack("<i" if isinstance(value, int) else "<f", value)
            crc = zlib.crc32(name.encode() + packed, crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
        (carried,) = struct.unpack("<f", struct.pack("<I", crc))
        return self._told(HASH, carried, mavlink.MAV_PARAM_TYPE_UINT32, NO_INDEX)

    def _set(self, message: Any) -> list[Any]:
        name = str(message.param_id)
        if name not in self._values:
            return self._unknown(message)
        is_int = isinstance(self._values[name], int)
        if message.param_type != (INT32 if is_int else REAL32):
            return [_error(message, TYPE_MISMATCH)]
        carried = message.param_value
        self.set(name, struct.unpack("<i", struct.pack("<f", carried))[0] if is_int else carried)
        return [self.message(name)]

    def _named(self, name: str) -> Any:
        return self.message(name)

    def _unknown(self, message: Any) -> list[Any]:
        return [_error(message, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)]

    def _encoded(self, value: float) -> float:
        return float(struct.unpack("<f", struct.pack("<i", value))[0]) if isinstance(value, int) else value


def _error(message: Any, error: int) -> Any:
    to = (message.get_srcSystem(), message.get_srcComponent())
    index = getattr(message, "param_index", -1)
    return mavlink.MAVLink_param_error_message(*to, str(message.param_id).encode(), index, error)
