"""What a case is, and the steps that several of them have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .pilot import Pilot

HEIGHT_M = 10.0
FLIGHT_S = 120.0
"""Longer than any step of a flight takes."""
SPOOL_UP_S = 1.5
"""An autopilot lets its motors speed up first: so long after arming that is over."""


@dataclass(frozen=True)
class Procedure:
    """A case by name, and on which of the autopilot's links it is flown."""

    fly: Callable[[Pilot], None]
    link: str = "onboard"
    counts: bool = False
    """Whether every message is of interest, not only those that tell the state."""


Procedures = dict[str, Procedure]


def case(
    among: Procedures, name: str, link: str = "onboard", *, counts: bool = False
) -> Callable[[Callable[[Pilot], None]], None]:
    """Enter a function among the cases of a module."""

    def enter(fly: Callable[[Pilot], None]) -> None:
        among[name] = Procedure(fly, link, counts)

    return enter


def arm(pilot: Pilot) -> None:
    """Armed, its motors at their speed."""
    pilot.arm()
    pilot.until("armed", lambda: pilot.armed, 10)
    pilot.wait(SPOOL_UP_S)


def up(pilot: Pilot, height_m: float = HEIGHT_M) -> None:
    """Armed and hovering."""
    arm(pilot)
    pilot.takeoff(height_m)
    pilot.until("takeoff half way", lambda: pilot.position[2] > height_m / 2, FLIGHT_S)
    pilot.until("takeoff", lambda: pilot.position[2] > height_m - 0.5, FLIGHT_S)
    pilot.until("takeoff to hold", lambda: pilot.rests, FLIGHT_S)
    pilot.wait(3)


def down(pilot: Pilot) -> None:
    """From landing or returning to disarmed; then what becomes of the mode."""
    pilot.until("landed", lambda: pilot.landed, FLIGHT_S)
    pilot.until("disarmed", lambda: not pilot.armed, 30)
    pilot.wait(4)


def go(pilot: Pilot, north_m: float) -> None:
    """Tracked from the ground up, and flown north."""
    pilot.track()
    up(pilot)
    pilot.goto(north_m, 0, HEIGHT_M)


def near(pilot: Pilot, north_m: float, up_m: float, within_m: float) -> Callable[[], bool]:
    return lambda: abs(pilot.position[0] - north_m) < within_m and abs(pilot.position[2] - up_m) < within_m
