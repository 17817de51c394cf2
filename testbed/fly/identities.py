"""Makes a flight's identities, in the ground station's node, before any role starts."""

from __future__ import annotations

import shlex

from ..errors import FleetError
from ..plan.experiments import Plan
from ..plan.identities import making
from .containers import Containers

LIMIT_S = 120.0


def make_identities(containers: Containers, plan: Plan) -> None:
    """Make the identities of a plan's fleet. Raises FleetError with the output of `mqttxt keys` if one fails."""
    made = making(plan.fleet, sensors=plan.has_sensors, page=plan.page is not None)
    commands = " && ".join(shlex.join(command) for command in made)
    lines = containers.execute("gs", ["sh", "-c", f"{{ {commands}; }} 2>&1"], limit_s=LIMIT_S)
    last = ""
    while True:
        try:
            last = next(lines)
        except StopIteration as stop:
            if stop.value != 0:
                raise FleetError(f"the fleet's identities: {last}") from None
            return
