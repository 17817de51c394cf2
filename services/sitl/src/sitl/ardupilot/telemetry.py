"""Messages that ArduCopter fills in its own way."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

from ..telemetry import MAKERS, Telemetry
from .autopilot import ArduCopter
from .modes import UNPOWERED, Mode

PRESENT, ENABLED, HEALTHY = 0x5371FC2F, 0x5361FC2F, 0x5771FC2F
"""The sensors of a quadrotor in ArduCopter's simulation (MAV_SYS_STATUS_SENSOR) when all is well."""
COMPASS_RAD = math.radians(0.9)
"""The error of its heading in its simulation, which at first faces exactly north."""
_STEERED = UNPOWERED | {Mode.ALT_HOLD, Mode.LAND}
"""Modes in which it does not fly to a place of its own accord."""


class CopterTelemetry(Telemetry):
    """ArduCopter's messages, and how its estimates wander."""

    _ap: ArduCopter
    wanders: ClassVar = {
        "north": (0.002, 0.003, 4.0),
        "east": (0.002, 0.003, 4.0),
        "up": (0.01, 0.004, 4.0),
        "climb": (0.01, 0.0015, 0.5),
        "speed": (0.005, 0.003, 1.0),
        "heading": (0.0001, 0.00015, 3.0),
        "roll": (0.00002, 0.0003, 0.3),
        "voltage": (0.0, 0.0, 0.3),
    }

    def _yaw(self) -> float:
        return super()._yaw() + (0.0 if self._quiet else COMPASS_RAD)

    def _heartbeat(self) -> Any:
        ap = self._ap
        base = (
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
            | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
            | (0 if ap.mode in _STEERED else mavlink.MAV_MODE_FLAG_GUIDED_ENABLED)
            | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if ap.armed else 0)
        )
        state = mavlink.MAV_STATE_STANDBY if ap.landed else mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            type=mavlink.MAV_TYPE_QUADROTOR,
            autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            base_mode=base,
            custom_mode=ap.mode.custom_mode,
            system_status=state,
            mavlink_version=3,
        )

    def _sys_status(self) -> Any:
        """Without a position, only PREARM_CHECK is unhealthy."""
        health = HEALTHY if self._ap.healthy else HEALTHY & ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
        return self._status(PRESENT, ENABLED, health, load=0)

    def _mission(self) -> Any:
        """The current item, and the number of items without home, which is item 0."""
        plans, flies = self._ap.plans, self._ap.mode is Mode.AUTO
        total = max(0, len(plans.mission) - 1)
        state = mavlink.MISSION_STATE_NO_MISSION
        if total:
            state = mavlink.MISSION_STATE_ACTIVE if flies else mavlink.MISSION_STATE_NOT_STARTED
        return mavlink.MAVLink_mission_current_message(min(plans.current, total), total, state, int(flies))

    makers: ClassVar = {
        **MAKERS,
        "MISSION_CURRENT": _mission,
        "HEARTBEAT": _heartbeat,
        "SYS_STATUS": _sys_status,
    }
