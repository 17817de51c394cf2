"""Fogs and drones as their ground station sees them: their states, and the commands to them."""

from .commands import TTL_S
from .drone import TAKEOVER_S, UPLOAD_TTL_S, Drone
from .fog import Fog
from .known_state import KnownState

__all__ = ["TAKEOVER_S", "TTL_S", "UPLOAD_TTL_S", "Drone", "Fog", "KnownState"]
