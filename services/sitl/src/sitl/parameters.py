"""Parameters with their types, ranges and defaults, and MAVLink's ways to carry them."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .errors import SitlError


@dataclass(frozen=True)
class Spec:
    """A parameter's default and range; an int default makes it an INT32 parameter, else it is REAL32."""

    default: float | int
    low: float
    high: float


class Parameters:
    """The parameters of one autopilot, in the order of their indices; whole numbers travel as numbers."""

    def __init__(self, specs: Mapping[str, Spec], overrides: Mapping[str, float] | None = None) -> None:
        self._specs = specs
        self._names = list(specs)
        self._values = {name: spec.default for name, spec in specs.items()}
        for name, value in (overrides or {}).items():
            if not self.set(name, value):
                spec = specs[name]
                raise SitlError(f"parameter {name}: expected {spec.low:g} to {spec.high:g}, got {value:g}")

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def set(self, name: str, value: float) -> bool:
        """Set one; False, and nothing changes, for an unknown name, NaN or a value out of range."""
        spec = self._specs.get(name)
        if spec is None or not spec.low <= value <= spec.high:
            return False
        self._values[name] = int(value) if isinstance(spec.default, int) else float(value)
        return True

    def message(self, name: str) -> Any:
        """PARAM_VALUE."""
        value, place = self._values[name], (len(self._names), self._names.index(name))
        kind = mavlink.MAV_PARAM_TYPE_INT32 if isinstance(value, int) else mavlink.MAV_PARAM_TYPE_REAL32
        return mavlink.MAVLink_param_value_message(name.encode(), self._encoded(value), kind, *place)

    def on_message(self, message: Any) -> list[Any]:
        """Answers to PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; an unknown name has none.

        A set of the wrong type or out of range is answered with the value that stays.
        """
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self.message(name) for name in self._names]
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            return [self.message(name) for name in self._names[message.param_index : message.param_index + 1]]
        name = str(message.param_id)
        if name not in self._values:
            return []
        if kind == "PARAM_SET" and (value := self._decoded(message, isinstance(self._values[name], int))) is not None:
            self.set(name, value)
        return [self.message(name)]

    def _encoded(self, value: float) -> float:
        """A value as PARAM_VALUE carries it."""
        return float(value)

    def _decoded(self, message: Any, is_int: bool) -> float | None:
        """A PARAM_SET's value; None for one of the wrong type."""
        return float(message.param_value)


class BytewiseParameters(Parameters):
    """Whole numbers travel as their bytes in the float's place, and have to be set as such."""

    def _encoded(self, value: float) -> float:
        return float(struct.unpack("<f", struct.pack("<i", value))[0]) if isinstance(value, int) else value

    def _decoded(self, message: Any, is_int: bool) -> float | None:
        if is_int != (message.param_type == mavlink.MAV_PARAM_TYPE_INT32):
            return None
        return int(struct.unpack("<i", struct.pack("<f", message.param_value))[0]) if is_int else message.param_value
