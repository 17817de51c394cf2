"""The scenarios: each a sequence of steps on any fleet."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from .fleet import Fleet
from .points import points_of
from .steps import Steps
from .surveys import surveys_of

ALTITUDE_M = 10.0
HOLD_S = 15.0


async def scenario_1(fleet: Fleet, steps: Steps) -> None:
    """Arm, take off to 10 m, hold for 15 s, land, all disarmed."""
    await _up(fleet, steps)
    await steps.hold(HOLD_S)
    await _land(fleet, steps)


async def scenario_2(fleet: Fleet, steps: Steps) -> None:
    """Arm, take off to 10 m, fly each drone to its own point, return to the takeoff points, land, all disarmed."""
    await _up(fleet, steps)
    await _out(fleet, steps)
    await _back(fleet, steps)


async def scenario_3(fleet: Fleet, steps: Steps) -> None:
    """Arm, take off to 10 m, land, all disarmed."""
    await _up(fleet, steps)
    await _land(fleet, steps)


async def scenario_4(fleet: Fleet, steps: Steps) -> None:
    """Scenario 2, but at its point each drone waits until all its sensor's values are at the ground station."""
    await _up(fleet, steps)
    await _out(fleet, steps)
    await steps.collect()
    await _back(fleet, steps)


async def scenario_5(fleet: Fleet, steps: Steps) -> None:
    """Upload a survey of 100 items to each drone, arm, fly it, return to the takeoff points, land, all disarmed."""
    surveys = surveys_of(fleet.drones)
    await steps.command("upload", lambda: fleet.upload(surveys), limit_s=300)
    await steps.command("arm", fleet.arm, limit_s=30)
    await steps.command("survey", fleet.fly_survey, limit_s=600)
    await _disarmed(fleet, steps)


async def _up(fleet: Fleet, steps: Steps) -> None:
    await steps.command("arm", fleet.arm, limit_s=30)
    await steps.command("takeoff", lambda: fleet.takeoff(ALTITUDE_M), limit_s=90)


async def _out(fleet: Fleet, steps: Steps) -> None:
    points = points_of(fleet.drones)
    await steps.command("goto", lambda: fleet.goto(points), limit_s=120)


async def _back(fleet: Fleet, steps: Steps) -> None:
    await steps.command("return", fleet.return_home, limit_s=240)
    await _disarmed(fleet, steps)


async def _land(fleet: Fleet, steps: Steps) -> None:
    await steps.command("land", fleet.land, limit_s=150)
    await _disarmed(fleet, steps)


async def _disarmed(fleet: Fleet, steps: Steps) -> None:
    await steps.until("disarmed", lambda drone: fleet.status(drone).armed is False, limit_s=45)


SCENARIOS: dict[str, Callable[[Fleet, Steps], Awaitable[None]]] = {
    "scenario-1": scenario_1,
    "scenario-2": scenario_2,
    "scenario-3": scenario_3,
    "scenario-4": scenario_4,
    "scenario-5": scenario_5,
}
"""Every scenario by its name on the command line."""
WITH_POINTS = ("scenario-2", "scenario-4", "scenario-5")
"""The scenarios that send each drone to a point of its own."""
WITH_SENSORS = ("scenario-4",)
"""The scenarios that collect sensors' readings."""
