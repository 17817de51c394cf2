"""Asks the autopilot for what it has not told by itself, so that other streams than PX4's onboard set do."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..dialect.vehicle import AUTOPILOT_COMPONENT, CRUISE_SPEED_PARAMETER, MAX_SPEED_PARAMETER, Vehicle

PATIENCE_MS = 3000
_GAP_MS = (0, 1000, 2000, 5000, 10_000, 30_000)
"""Pauses between the askings for one thing; the last one repeats."""

_RATES_HZ = {
    "battery": (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 0.5),
    "location": (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 5),
    "groundspeed": (mavlink.MAVLINK_MSG_ID_VFR_HUD, 4),
    "landed_state": (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 5),
    "health": (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1),
}
_PARAMETERS = (MAX_SPEED_PARAMETER, CRUISE_SPEED_PARAMETER)
"""What no stream carries."""


class Enquiries:
    """What was asked when; nothing but parameters is asked for before `PATIENCE_MS`."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._asked: dict[str, tuple[int, int]] = {}
        self._first_ms: int | None = None

    def due(self, now_ms: int) -> list[Any]:
        """The MAVLink messages to send now."""
        if not self._vehicle.is_alive(now_ms):
            return []
        if self._first_ms is None:
            self._first_ms = now_ms
        patient = now_ms - self._first_ms < PATIENCE_MS
        missing = [name for name in _PARAMETERS if name not in self._vehicle.parameters]
        if not patient:
            missing += [name for name in (*_RATES_HZ, "home") if name not in self._vehicle.states]
        return [self._question(name) for name in missing if self._is_due(name, now_ms)]

    def _is_due(self, name: str, now_ms: int) -> bool:
        count, next_ms = self._asked.get(name, (0, 0))
        if now_ms < next_ms:
            return False
        gap = _GAP_MS[min(count + 1, len(_GAP_MS) - 1)]
        self._asked[name] = (count + 1, now_ms + gap)
        return True

    def _question(self, name: str) -> Any:
        target = (self._vehicle.system_id, AUTOPILOT_COMPONENT)
        if name in _PARAMETERS:
            return mavlink.MAVLink_param_request_read_message(*target, name.encode(), -1)
        if name == "home":
            params = (float(mavlink.MAVLINK_MSG_ID_HOME_POSITION), 0.0)
            return mavlink.MAVLink_command_long_message(
                *target, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, *params, 0.0, 0.0, 0.0, 0.0, 0.0
            )
        message_id, rate_hz = _RATES_HZ[name]
        params = (float(message_id), 1e6 / rate_hz)
        return mavlink.MAVLink_command_long_message(
            *target, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, *params, 0.0, 0.0, 0.0, 0.0, 0.0
        )
