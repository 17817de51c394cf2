"""The kinds of autopilots that the stand-in can be like, by name."""

from __future__ import annotations

from .ardupilot.personality import ARDUCOPTER
from .personality import Personality
from .px4.personality import PX4

PERSONALITIES: dict[str, Personality] = {kind.name: kind for kind in (PX4, ARDUCOPTER)}
