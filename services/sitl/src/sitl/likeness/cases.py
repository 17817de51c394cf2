"""The cases: procedures that show how an autopilot answers; each begins disarmed, on the ground and at rest."""

from __future__ import annotations

from .answers import ANSWERS
from .flights import FLIGHTS
from .logs import LOGS
from .messages import MESSAGES
from .plans import PLANS
from .procedures import Procedures
from .settings import SETTINGS

CASES: Procedures = FLIGHTS | ANSWERS | MESSAGES | PLANS | SETTINGS | LOGS
