"""The heartbeats sent to the autopilot every second: the UAV client's own, and a station's while one is in control."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from .effects import Transmit
from .mavlink.sources import Source

INTERVAL_MS = 1000


class Heartbeats:
    """When the next heartbeats are due, in ms of the session clock."""

    def __init__(self) -> None:
        self._next_ms = 0

    def due(self, now_ms: int, is_controlled: bool) -> list[Transmit]:
        """The heartbeats to send now. Without `is_controlled` the station's stop, so the autopilot detects its loss."""
        if now_ms < self._next_ms:
            return []
        self._next_ms = now_ms + INTERVAL_MS
        station = [Transmit(_heartbeat(mavlink.MAV_TYPE_GCS), source=Source.GCS)] if is_controlled else []
        return [Transmit(_heartbeat(mavlink.MAV_TYPE_ONBOARD_CONTROLLER)), *station]


def _heartbeat(kind: int) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)
