"""The kinds of autopilots that are known, by HEARTBEAT.autopilot."""

from __future__ import annotations

from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from .autopilot import Autopilot
from .px4 import Px4

AUTOPILOTS: Final[dict[int, Autopilot]] = {mavlink.MAV_AUTOPILOT_PX4: Px4()}
