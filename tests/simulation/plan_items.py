"""Items of plans near home, by metres, and a plan of them: a square, a fence, and a rally point."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from mqttxt.protocol.plans import PlanItem, PlanObject

HOME = (473_977_420, 85_455_940)
"""Latitude and longitude in 1e-7 degrees; `METRES` has a metre north and a metre east there, in this unit."""
METRES = (1 / 0.0111319, 1 / 0.0075353)
ABOVE = 12.0


def place(command: int, north_m: float, east_m: float, up_m: float, *params: float | None) -> PlanItem:
    """An item at a place, `up_m` above home."""
    x, y = (at + round(metres * way) for at, metres, way in zip(HOME, (north_m, east_m), METRES, strict=True))
    return PlanItem(mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, command, _four(params), x, y, up_m, True)


def plain(command: int, *params: float) -> PlanItem:
    """An item without a place."""
    return PlanItem(mavlink.MAV_FRAME_MISSION, command, _four(params), 0, 0, 0.0, True)


def _four(params: tuple[float | None, ...]) -> tuple[float | None, ...]:
    return (*params, *[0.0] * (4 - len(params)))


UP = place(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, ABOVE, 0, 0, 0, None)
SQUARE = tuple(place(mavlink.MAV_CMD_NAV_WAYPOINT, *at, ABOVE) for at in ((30, 0), (30, 30), (0, 30)))
BACK = plain(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
FENCE = tuple(
    place(mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, *at, 0, 4)
    for at in ((-200, -200), (200, -200), (200, 200), (-200, 200))
)
RALLY = (place(mavlink.MAV_CMD_NAV_RALLY_POINT, 20, 0, 15),)
ROUND_TRIP = PlanObject(mission=(UP, *SQUARE, BACK), fence=FENCE, rally=RALLY)
