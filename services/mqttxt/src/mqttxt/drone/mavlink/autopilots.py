"""The known kinds of autopilots, by HEARTBEAT."""

from __future__ import annotations

from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from .ardupilot import ArduCopter
from .autopilot import Autopilot
from .plans import AUTOPILOT_COMPONENT
from .px4 import Px4

AUTOPILOTS: Final[dict[int, Autopilot]] = {
    mavlink.MAV_AUTOPILOT_PX4: Px4(),
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ArduCopter(),
}
"""By HEARTBEAT.autopilot."""


def is_autopilots(message: Any) -> bool:
    """Whether a message is the heartbeat of a flight controller, of a known kind or not."""
    if message.get_type() != "HEARTBEAT" or message.get_srcComponent() != AUTOPILOT_COMPONENT:
        return False
    return bool(message.autopilot != mavlink.MAV_AUTOPILOT_INVALID)


def kind_of(heartbeat: Any) -> Autopilot | None:
    """The kind in a HEARTBEAT, None for an unknown one, such as ArduPilot's planes, which have other modes."""
    found = AUTOPILOTS.get(heartbeat.autopilot)
    return found if found is None or found.types is None or heartbeat.type in found.types else None
