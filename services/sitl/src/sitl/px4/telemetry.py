"""What PX4 says in its own way."""

from __future__ import annotations

import itertools
import math
from typing import Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

from ..autopilot import FlightMode
from ..dynamics import Place
from ..telemetry import MAKERS, Telemetry
from ..unnamed import Unnamed
from .autopilot import Px4
from .modes import Mode

SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_GEOFENCE
)
HOME_M = 0.25
"""A smaller error of it is not corrected."""
_EXTENDED = mavlink.MAV_SYS_STATUS_RECOVERY_SYSTEM
HOME_S = 2.0
"""How often home's height is corrected in flight."""


class Px4Telemetry(Telemetry):
    """PX4's messages, and how its estimates wander."""

    _ap: Px4
    wanders: ClassVar = {
        "north": (0.04, 0.26, 8.0),
        "east": (0.04, 0.26, 8.0),
        "up": (0.004, 0.11, 5.0),
        "climb": (0.005, 0.12, 0.5),
        "speed": (0.012, 0.1, 1.0),
        "heading": (0.0015, 0.0028, 3.0),
        "roll": (0.001, 0.02, 0.3),
        "voltage": (0.0, 0.06, 0.3),
        "home": (0.0, 0.45, 3.0),
    }

    def __init__(self, autopilot: Px4, seed: int, *, quiet: bool = False) -> None:
        super().__init__(autopilot, seed, quiet=quiet)
        self._home_error_m, self._home_s = 0.0, -math.inf
        self._modes = itertools.cycle(enumerate(Mode, 1))

    def _home(self) -> Place:
        """Home, whose height PX4 corrects in flight as its estimate of the height changes."""
        home, now_s = self._ap.guidance.home, self._ap.now_s
        if now_s - self._home_s >= HOME_S:
            self._home_s, error_m = now_s, self._wander("home")
            if abs(error_m - self._home_error_m) > HOME_M:
                self._home_error_m = error_m
        return Place(home.latitude_deg, home.longitude_deg, home.altitude_m + self._home_error_m)

    def _heartbeat(self) -> Any:
        ap = self._ap
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if ap.armed else 0)
        state = mavlink.MAV_STATE_ACTIVE if ap.armed else mavlink.MAV_STATE_STANDBY
        if ap.failsafe:
            state = mavlink.MAV_STATE_CRITICAL
        kind = int(ap.parameters["MAV_TYPE"])
        return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_PX4, base, ap.mode.custom_mode, state, 3)

    def _sys_status(self) -> Any:
        """PX4 says PREARM_CHECK in health alone, and never that it is present."""
        health = SENSORS & ~mavlink.MAV_SYS_STATUS_SENSOR_GPS
        if self._ap.healthy:
            health = SENSORS | mavlink.MAV_SYS_STATUS_PREARM_CHECK
        battery = self._ap.battery
        return mavlink.MAVLink_sys_status_message(
            *(SENSORS, SENSORS, health, 250, round(self._voltage_v() * 1000), self._current_ca()),
            *(round(battery.remaining_pct), 0, 0, 0, 0, 0, 0, _EXTENDED, _EXTENDED, _EXTENDED),
        )

    def _mission(self) -> Any:
        state = mavlink.MISSION_STATE_NO_MISSION
        return mavlink.MAVLink_mission_current_message(0, 0, state, 1 if self._ap.mode is Mode.MISSION else 2)

    def _current_mode(self) -> Any:
        mode = self._ap.mode
        return mavlink.MAVLink_current_mode_message(_STANDARD_MODES.get(mode, 0), mode.custom_mode, mode.custom_mode)

    def _available_modes(self) -> Any:
        """One of the modes, another one each time."""
        index, mode = next(self._modes)
        return mavlink.MAVLink_available_modes_message(
            *(len(Mode), index, _STANDARD_MODES.get(mode, 0), mode.custom_mode, 0, mode.name.title().encode())
        )

    def _link(self) -> Any:
        return Unnamed("LINK_NODE_STATUS", (self._usec(), 25_000, 100, self._sent, 1, 0, 0, 0, 0, 0, 0))

    def _time_estimate(self) -> Any:
        return Unnamed("TIME_ESTIMATE_TO_TARGET", (-1, -1, -1, -1, -1))

    def _event_sequence(self) -> Any:
        return Unnamed("CURRENT_EVENT_SEQUENCE", (7, 0))

    makers: ClassVar = {
        **MAKERS,
        "HEARTBEAT": _heartbeat,
        "SYS_STATUS": _sys_status,
        "MISSION_CURRENT": _mission,
        "CURRENT_MODE": _current_mode,
        "AVAILABLE_MODES": _available_modes,
        "LINK_NODE_STATUS": _link,
        "TIME_ESTIMATE_TO_TARGET": _time_estimate,
        "CURRENT_EVENT_SEQUENCE": _event_sequence,
    }


_STANDARD_MODES: dict[FlightMode, int] = {
    Mode.POSITION: mavlink.MAV_STANDARD_MODE_POSITION_HOLD,
    Mode.ALTITUDE: mavlink.MAV_STANDARD_MODE_ALTITUDE_HOLD,
    Mode.RETURN: mavlink.MAV_STANDARD_MODE_SAFE_RECOVERY,
    Mode.MISSION: mavlink.MAV_STANDARD_MODE_MISSION,
    Mode.LAND: mavlink.MAV_STANDARD_MODE_LAND,
    Mode.TAKEOFF: mavlink.MAV_STANDARD_MODE_TAKEOFF,
}
