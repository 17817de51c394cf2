"""The definition of a case, and the steps that several cases have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .pilot import Pilot

HEIGHT_M = 10.0
FLIGHT_S = 120.0
"""Longer than any step of a flight takes."""
SPOOL_UP_S = 1.5
"""The time after arming until the motors have sped up."""


@dataclass(frozen=True)
class Procedure:
    """A case, and on which of the autopilot's links it is flown."""

    fly: Callable[[Pilot], None]
    link: str = "onboard"
    counts: bool = False
    """Whether every message is of interest, not only those that report the state."""


Procedures = dict[str, Procedure]


def case(
    among: Procedures, name: str, link: str = "onboard", *, counts: bool = False
) -> Callable[[Callable[[Pilot], None]], None]:
    """Register the decorated function among a module's cases."""

    def enter(fly: Callable[[Pilot], None]) -> None:
        among[name] = Procedure(fly, link, counts)

    return enter


def arm(pilot: Pilot) -> None:
    """Arm, and wait until the motors have sped up."""
    pilot.arm()
    pilot.until("armed", lambda: pilot.armed, 10)
    pilot.wait(SPOOL_UP_S)


def up(pilot: Pilot, height_m: float = HEIGHT_M) -> None:
    """Arm, take off and hover."""
    arm(pilot)
    pilot.takeoff(height_m)
    pilot.until("takeoff half way", lambda: pilot.position[2] > height_m / 2, FLIGHT_S)
    pilot.until("takeoff", lambda: pilot.position[2] > height_m - 0.5, FLIGHT_S)
    pilot.until("takeoff to hold", lambda: pilot.rests, FLIGHT_S)
    pilot.wait(3)


def down(pilot: Pilot) -> None:
    """Wait until it has landed and disarmed; then a while for changes of the mode."""
    pilot.until("landed", lambda: pilot.landed, FLIGHT_S)
    pilot.until("disarmed", lambda: not pilot.armed, 30)
    pilot.wait(4)


def go(pilot: Pilot, north_m: float) -> None:
    """Track the position, take off and fly north."""
    pilot.track()
    up(pilot)
    pilot.goto(north_m, 0, HEIGHT_M)


def near(pilot: Pilot, north_m: float, up_m: float, within_m: float) -> Callable[[], bool]:
    return lambda: abs(pilot.position[0] - north_m) < within_m and abs(pilot.position[2] - up_m) < within_m
