"""How to talk to an autopilot: its modes' numbers, the meaning of altitudes, its parameters' encoding."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..ardupilot import modes as ardupilot
from ..ardupilot.parameters import SPECS as COPTER_SPECS
from ..px4 import modes as px4
from ..px4.parameters import SPECS


@dataclass(frozen=True)
class Manners:
    """One family of autopilots; `modes` are its custom_mode numbers by name, `parameters` those that are recorded.

    `rest` is the mode in which it waits, on the ground and after a takeoff; `brake` the one that stops it, None if a
    reposition does. `unused` is the value of an unused command parameter. `asks` are the messages that it sends only on
    request, in Hz. `on_ground` and `in_air` are the modes to try, `odd_modes` invalid ones as DO_SET_MODE's parameters.
    `mission` is the mode that flies a mission, whose first item is home if `has_home_item`.
    `experiments` are the parameters with which the experiments fly, `a_float` and `a_whole` one of each type.
    `first_log` is the number of its first log.
    """

    name: str
    modes: Mapping[str, int]
    rest: str
    brake: str | None
    unused: float
    on_ground: Sequence[str]
    in_air: Sequence[str]
    odd_modes: Mapping[str, Sequence[float]]
    parameters: Sequence[str]
    experiments: Mapping[str, float]
    a_float: str
    a_whole: str
    mission: str
    has_home_item: bool
    first_log: int
    asks: Mapping[str, float] = field(default_factory=dict)

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

    def carried(self, value: float, is_whole: bool) -> float:
        """A value as PARAM_SET carries it."""
        return value


class Px4Manners(Manners):
    """PX4: modes in main and sub, altitudes above mean sea level, integers bytewise."""

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

    def carried(self, value: float, is_whole: bool) -> float:
        return float(struct.unpack("<f", struct.pack("<i", round(value)))[0]) if is_whole else value


class CopterManners(Manners):
    """ArduCopter: modes are numbers, a takeoff's height is above home, and NaN crashes it."""

    def mode_params(self, mode: str) -> Sequence[float]:
        return (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, self.modes[mode])

    def takeoff_params(self, amsl_m: float, above_home_m: float) -> Sequence[float]:
        return (*[0.0] * 6, above_home_m)


BY_REQUEST = {
    **dict.fromkeys(("ATTITUDE", "LOCAL_POSITION_NED"), 20.0),
    **dict.fromkeys(("GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE"), 10.0),
    "SYS_STATUS": 2.0,
    "BATTERY_STATUS": 1.0,
    "HOME_POSITION": 0.5,
}
"""The messages by which a flight is followed, in Hz, on a link that sends them only on request."""
_TRIED = ("position", "altitude", "stabilized", "manual", "acro", "mission", "offboard", "takeoff", "hold")
PX4 = Px4Manners(
    name="px4",
    modes={mode.name.lower(): mode.custom_mode for mode in px4.Mode},
    rest="hold",
    brake=None,
    unused=math.nan,
    on_ground=_TRIED,
    in_air=_TRIED,
    odd_modes={
        "mode 9 9": (1, 9, 9),
        "mode 4 99": (1, 4, 99),
        "mode without the custom flag": (0, 4, 3),
        "mode NaN": (1, math.nan, 0),
    },
    parameters=[name for name in SPECS if name != "MAV_SYS_ID"],
    experiments={"RTL_RETURN_ALT": 10, "MPC_XY_CRUISE": 12},
    a_float="MPC_XY_CRUISE",
    a_whole="NAV_DLL_ACT",
    mission="mission",
    has_home_item=False,
    first_log=0,
)
ARDUCOPTER = CopterManners(
    name="ardupilot",
    modes={{"rtl": "return"}.get(mode.name.lower(), mode.name.lower()): mode.custom_mode for mode in ardupilot.Mode},
    rest="guided",
    brake="brake",
    unused=0.0,
    on_ground=("stabilize", "acro", "alt_hold", "auto", "loiter", "return", "poshold", "brake", "guided"),
    in_air=("auto", "poshold", "brake", "guided"),
    odd_modes={"mode 99": (1, 99), "mode without the custom flag": (0, 4)},
    parameters=[name for name in COPTER_SPECS if name != "SYSID_THISMAV"],
    experiments={"RTL_ALT": 1000, "WPNAV_SPEED": 1200},
    a_float="WPNAV_SPEED",
    a_whole="RTL_LOIT_TIME",
    mission="auto",
    has_home_item=True,
    first_log=1,
    asks=BY_REQUEST,
)
MANNERS = {manners.name: manners for manners in (PX4, ARDUCOPTER)}
