"""Each UAV's survey in scenario 5: lanes that begin at its own point, after a takeoff and before the return."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import cos, radians

from .fleet import Point, Survey
from .points import points_of

LANES, POINTS_PER_LANE = 7, 14
LANE_M, POINT_M = 4.0, 3.0
"""The distance between lanes, and between the points of a lane."""
_M_PER_DEGREE = 111_195.0


def surveys_of(drones: Iterable[int]) -> dict[int, Survey]:
    """The surveys of these drones, of 100 items each. Raises ValueError for a drone without a point."""
    return {drone: Survey(tuple(_lanes(point))) for drone, point in points_of(drones).items()}


def _lanes(corner: Point) -> Iterable[Point]:
    """The points of lanes flown to and fro, north and east of a corner."""
    east_m_per_degree = _M_PER_DEGREE * cos(radians(corner.latitude_deg))
    for lane in range(LANES):
        along = range(POINTS_PER_LANE) if lane % 2 == 0 else reversed(range(POINTS_PER_LANE))
        for place in along:
            yield replace(
                corner,
                latitude_deg=corner.latitude_deg + lane * LANE_M / _M_PER_DEGREE,
                longitude_deg=corner.longitude_deg + place * POINT_M / east_m_per_degree,
            )
