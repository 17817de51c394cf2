"""How an autopilot is spoken to: its modes' numbers, the meaning of altitudes, its parameters' encoding."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..px4.modes import Mode
from ..px4.parameters import SPECS


@dataclass(frozen=True)
class Manners:
    """One family of autopilots; `modes` are its custom_mode numbers by name."""

    name: str
    modes: Mapping[str, int]
    parameters: Sequence[str] = ()
    """Those whose defaults are recorded."""

    def mode_name(self, custom_mode: int) -> str:
        """A mode's name, or its number."""
        return next((name for name, number in self.modes.items() if number == custom_mode), str(custom_mode))

    def mode_params(self, mode: str) -> Sequence[float]:
        """DO_SET_MODE's parameters."""
        raise NotImplementedError

    def takeoff_params(self, amsl_m: float, above_home_m: float) -> Sequence[float]:
        """NAV_TAKEOFF's seven parameters."""
        raise NotImplementedError

    def parameter_value(self, message: Any) -> float:
        """The value of a PARAM_VALUE."""
        return float(message.param_value)

    def parameter_set(self, system: int, name: str, value: float, is_int: bool) -> Any:
        """PARAM_SET."""
        kind = mavlink.MAV_PARAM_TYPE_INT32 if is_int else mavlink.MAV_PARAM_TYPE_REAL32
        return mavlink.MAVLink_param_set_message(system, 1, name.encode(), value, kind)


class Px4Manners(Manners):
    """PX4: modes in main and sub, altitudes above mean sea level, integers bytewise."""

    def __init__(self) -> None:
        super().__init__(
            "px4",
            {mode.name.lower(): mode.custom_mode for mode in Mode},
            tuple(name for name in SPECS if name != "MAV_SYS_ID"),
        )

    def mode_params(self, mode: str) -> Sequence[float]:
        number = self.modes[mode]
        return (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, number >> 16 & 0xFF, number >> 24 & 0xFF)

    def takeoff_params(self, amsl_m: float, above_home_m: float) -> Sequence[float]:
        nan = float("nan")
        return (nan, 0, 0, nan, nan, nan, amsl_m)

    def parameter_value(self, message: Any) -> float:
        if message.param_type == mavlink.MAV_PARAM_TYPE_INT32:
            return float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])
        return float(message.param_value)

    def parameter_set(self, system: int, name: str, value: float, is_int: bool) -> Any:
        wire = struct.unpack("<f", struct.pack("<i", int(value)))[0] if is_int else value
        return super().parameter_set(system, name, wire, is_int)


PX4 = Px4Manners()
