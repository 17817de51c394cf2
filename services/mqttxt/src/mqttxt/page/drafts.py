"""A plan in the form of the page's mission editor, or the reason why the editor cannot have it."""

from __future__ import annotations

from dataclasses import dataclass

from ..protocol.plans import PlanItem
from ..station.plan import Plan

WAYPOINT, RETURN, TAKEOFF = 16, 20, 22
"""MAV_CMDs."""
LAST = 95
"""MAV_CMD_NAV_LAST: the commands below it fly somewhere."""
WITHOUT_PLACE, ABOVE_HOME = 2, 3
"""MAV_FRAMEs."""


@dataclass(frozen=True)
class Waypoint:
    """A place in degrees, and its height in metres above home."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True)
class Draft:
    """The editor's form of a mission: waypoints, before them a takeoff to the first one's height, then a return."""

    waypoints: tuple[Waypoint, ...]
    takes_off: bool
    returns: bool


def draft_of(plan: Plan) -> Draft | str:
    """A plan as a draft, or the reason why the editor would lose a part of it."""
    mission = plan.content.mission or ()
    if plan.content.fence:
        return "it has a geofence"
    if plan.content.rally:
        return "it has rally points"
    takes_off = bool(mission) and mission[0].command == TAKEOFF
    returns = bool(mission) and mission[-1].command == RETURN
    within = mission[takes_off : len(mission) - returns]
    if not within:
        return "it has no waypoint"
    for number, item in enumerate(mission, start=1):
        why = _unknown(item, takes_off < number <= len(mission) - returns, within[0].z)
        if why is not None:
            return f"item {number} {why}"
    places = tuple(Waypoint(item.x / 1e7, item.y / 1e7, item.z or 0.0) for item in within)
    return Draft(places, takes_off, returns)


def path_of(plan: Plan) -> list[tuple[float, float]]:
    """The positions to which a plan's mission flies, in degrees north and east."""
    items = [item for item in plan.content.mission or () if item.command < LAST and item.frame != WITHOUT_PLACE]
    return [(item.x / 1e7, item.y / 1e7) for item in items if (item.x, item.y) != (0, 0)]


def _unknown(item: PlanItem, is_waypoint: bool, height_m: float | None) -> str | None:
    """The part of an item that the editor would lose; a takeoff's pitch, which multicopters lack, does not count.

    `height_m` is the first waypoint's.
    """
    if is_waypoint and item.command != WAYPOINT:
        return f"is MAV_CMD {item.command}, and no waypoint"
    if item.frame != (WITHOUT_PLACE if item.command == RETURN else ABOVE_HOME):
        return "is not above home"
    if not item.autocontinue:
        return "does not go on by itself"
    hold, *others, yaw_deg = item.params
    is_set = any(others) or (yaw_deg if item.command == RETURN else yaw_deg is not None)
    if is_set or (hold and item.command != TAKEOFF):
        return "has parameters that the editor does not have"
    if item.command == TAKEOFF and item.z != height_m:
        return "takes off to another height than the first waypoint's"
    return None
