"""Parameters with PX4's names, types and defaults, and MAVLink's way to carry them."""

from __future__ import annotations

import struct
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from .errors import SitlError

DEFAULTS: dict[str, float | int] = {
    "BAT1_CAPACITY": 5000.0,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_OF_LOSS_T": 1.0,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_LAND_ALT1": 10.0,
    "MPC_LAND_ALT2": 5.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_TKO_SPEED": 1.5,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_V_AUTO_DN": 1.5,
    "MPC_Z_V_AUTO_UP": 3.0,
    "NAV_ACC_RAD": 10.0,
    "NAV_DLL_ACT": 0,
    "RTL_RETURN_ALT": 60.0,
    "SYS_AUTOSTART": 10016,
}
"""As PX4 ships them (multicopter); an int is an INT32 parameter."""


class Parameters:
    """The parameters of one autopilot."""

    def __init__(self, overrides: dict[str, float] | None = None) -> None:
        self._values = dict(DEFAULTS)
        for name, value in (overrides or {}).items():
            if name not in self._values:
                raise SitlError(f"parameter {name}: expected one of {', '.join(DEFAULTS)}")
            self.set(name, value)

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def set(self, name: str, value: float) -> None:
        self._values[name] = int(value) if isinstance(DEFAULTS[name], int) else float(value)

    def names(self) -> list[str]:
        """In the order of their indices."""
        return sorted(self._values)

    def message(self, name: str) -> Any:
        """PARAM_VALUE; an INT32 travels as its bytes in the float's place."""
        value = self._values[name]
        if isinstance(value, int):
            wire, kind = _as_float(value), mavlink.MAV_PARAM_TYPE_INT32
        else:
            wire, kind = value, mavlink.MAV_PARAM_TYPE_REAL32
        return mavlink.MAVLink_param_value_message(
            name.encode(), wire, kind, len(self._values), self.names().index(name)
        )

    def on_message(self, message: Any) -> list[Any]:
        """Answers to PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; an unknown name has none."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self.message(name) for name in self.names()]
        name = str(message.param_id)
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            names = self.names()
            return [self.message(names[message.param_index])] if message.param_index < len(names) else []
        if name not in self._values:
            return []
        if kind == "PARAM_SET":
            is_int = message.param_type == mavlink.MAV_PARAM_TYPE_INT32
            self.set(name, _as_int(message.param_value) if is_int else message.param_value)
        return [self.message(name)]


def _as_float(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def _as_int(value: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", value))[0])
