"""Fogs and drones as their ground station sees them: their states, and the commands to them."""

from .commands import TTL_S
from .drone import TAKEOVER_S, UPLOAD_TTL_S, Drone, KnownState
from .fog import Fog

__all__ = ["TAKEOVER_S", "TTL_S", "UPLOAD_TTL_S", "Drone", "Fog", "KnownState"]
