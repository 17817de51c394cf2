"""The scenarios: each a sequence of steps on any fleet."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from .fleet import Fleet
from .steps import Steps

ALTITUDE_M = 10.0
HOLD_S = 15.0


async def scenario_1(fleet: Fleet, steps: Steps) -> None:
    """Arm, take off to 10 m, hold for 15 s, land, all disarmed."""
    await steps.command("arm", fleet.arm, limit_s=30)
    await steps.command("takeoff", lambda: fleet.takeoff(ALTITUDE_M), limit_s=90)
    await steps.hold(HOLD_S)
    await steps.command("land", fleet.land, limit_s=150)
    await steps.until("disarmed", lambda drone: fleet.status(drone).armed is False, limit_s=45)


SCENARIOS: dict[str, Callable[[Fleet, Steps], Awaitable[None]]] = {"scenario-1": scenario_1}
"""Every scenario by the name that people type."""
