"""Fogs and drones as their ground station sees them: their states, and the commands to them."""

from .commands import TTL_S
from .drone import CARRIED_S, TAKEOVER_S, UPLOAD_TTL_S, Drone
from .fog import Fog
from .known_state import STALE_MS, KnownState

__all__ = ["CARRIED_S", "STALE_MS", "TAKEOVER_S", "TTL_S", "UPLOAD_TTL_S", "Drone", "Fog", "KnownState"]
