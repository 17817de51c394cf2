"""Parameters with PX4's names, types and defaults, and MAVLink's way to carry them."""

from __future__ import annotations

import struct
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


SPECS: dict[str, Spec] = {
    "BAT1_CAPACITY": Spec(-1.0, -1, 1_000_000),
    "COM_DISARM_LAND": Spec(2.0, -1, 20),
    "COM_DISARM_PRFLT": Spec(10.0, -1, 3600),
    "COM_OF_LOSS_T": Spec(1.0, 0, 60),
    "COM_SPOOLUP_TIME": Spec(1.0, 0, 30),
    "MAV_SYS_ID": Spec(1, 1, 250),
    "MAV_TYPE": Spec(2, 0, 22),
    "MIS_TAKEOFF_ALT": Spec(2.5, 0, 80),
    "MPC_ACC_DOWN_MAX": Spec(3.0, 2, 15),
    "MPC_ACC_HOR": Spec(3.0, 2, 15),
    "MPC_ACC_UP_MAX": Spec(4.0, 2, 15),
    "MPC_JERK_AUTO": Spec(4.0, 1, 80),
    "MPC_LAND_ALT1": Spec(10.0, 0, 100),
    "MPC_LAND_ALT2": Spec(5.0, 0, 100),
    "MPC_LAND_ALT3": Spec(1.0, 0, 100),
    "MPC_LAND_CRWL": Spec(0.3, 0.1, 2),
    "MPC_LAND_SPEED": Spec(0.7, 0.2, 3),
    "MPC_TKO_RAMP_T": Spec(3.0, 0, 5),
    "MPC_TKO_SPEED": Spec(1.5, 0.5, 5),
    "MPC_XY_CRUISE": Spec(5.0, 0.5, 20),
    "MPC_XY_VEL_MAX": Spec(12.0, 0.5, 20),
    "MPC_Z_VEL_MAX_DN": Spec(1.5, 0.5, 4),
    "MPC_Z_VEL_MAX_UP": Spec(3.0, 0.5, 8),
    "MPC_Z_V_AUTO_DN": Spec(1.5, 0.5, 4),
    "MPC_Z_V_AUTO_UP": Spec(3.0, 0.5, 8),
    "NAV_ACC_RAD": Spec(2.0, 0.05, 200),
    "NAV_DLL_ACT": Spec(0, 0, 6),
    "RTL_CONE_ANG": Spec(45, 0, 90),
    "RTL_MIN_DIST": Spec(10.0, 0.5, 100),
    "RTL_RETURN_ALT": Spec(30.0, 0, 1000),
    "SIM_BAT_DRAIN": Spec(60.0, 1, 86_400),
    "SIM_BAT_MIN_PCT": Spec(50.0, 0, 100),
    "SYS_AUTOSTART": Spec(10040, 0, 99_999_999),
}
"""Names, types and defaults as PX4 ships them (multicopter), in the order of their indices; ranges about PX4's."""
_NAMES = list(SPECS)


class Parameters:
    """The parameters of one autopilot."""

    def __init__(self, overrides: dict[str, float] | None = None) -> None:
        self._values = {name: spec.default for name, spec in SPECS.items()}
        for name, value in (overrides or {}).items():
            if not self.set(name, value):
                raise SitlError(f"parameter {name}: {value!r} is not possible")

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def set(self, name: str, value: float) -> bool:
        """Set one; False, and nothing changes, for an unknown name, NaN or a value out of range."""
        spec = SPECS.get(name)
        if spec is None or not spec.low <= value <= spec.high:
            return False
        self._values[name] = int(value) if isinstance(spec.default, int) else float(value)
        return True

    def message(self, name: str) -> Any:
        """PARAM_VALUE; an INT32 travels as its bytes in the float's place."""
        value = self._values[name]
        if isinstance(value, int):
            wire, kind = _as_float(value), mavlink.MAV_PARAM_TYPE_INT32
        else:
            wire, kind = value, mavlink.MAV_PARAM_TYPE_REAL32
        return mavlink.MAVLink_param_value_message(name.encode(), wire, kind, len(_NAMES), _NAMES.index(name))

    def on_message(self, message: Any) -> list[Any]:
        """Answers to PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; an unknown name has none.

        A set of the wrong type or out of range is answered with the value that stays.
        """
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self.message(name) for name in _NAMES]
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            return [self.message(name) for name in _NAMES[message.param_index : message.param_index + 1]]
        name = str(message.param_id)
        if name not in self._values:
            return []
        if kind == "PARAM_SET":
            is_int = message.param_type == mavlink.MAV_PARAM_TYPE_INT32
            if is_int == isinstance(SPECS[name].default, int):
                self.set(name, _as_int(message.param_value) if is_int else message.param_value)
        return [self.message(name)]


def _as_float(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def _as_int(value: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", value))[0])
