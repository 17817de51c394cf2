"""From a drone's lists to a plan file that QGroundControl opens."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..errors import PayloadError
from ..protocol.plans import PlanItem, PlanObject
from .plan_reading import EXCLUSION_CIRCLE, FENCE_RETURN, INCLUSION_CIRCLE, INCLUSION_VERTEX, MISSION_FRAME, RELATIVE

_PX4, _MULTICOPTER = 12, 2
"""The MAV_AUTOPILOT and MAV_TYPE for which QGroundControl plans while no vehicle is connected."""


def document_of(content: PlanObject, home: tuple[float, float, float] | None) -> dict[str, Any]:
    """The JSON object of a plan file; an unknown list is written as an empty one. Raises PayloadError for items that
    the format cannot express."""
    items = content.mission or ()
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "MQTT-XT",
        "mission": {
            "version": 2,
            "firmwareType": _PX4,
            "vehicleType": _MULTICOPTER,
            "cruiseSpeed": 15,
            "hoverSpeed": 5,
            "globalPlanAltitudeMode": 1,
            "plannedHomePosition": list(home or _first_place(items)),
            "items": [_simple(number, item) for number, item in enumerate(items, start=1)],
        },
        "geoFence": _fence(content.fence or ()),
        "rallyPoints": {
            "version": 2,
            "points": [_point(number, item) for number, item in enumerate(content.rally or (), start=1)],
        },
    }


def _first_place(items: Iterable[PlanItem]) -> tuple[float, float, float]:
    """The position of the mission's first placed item, with altitude 0: the ground's is not known."""
    placed = (item for item in items if item.frame != MISSION_FRAME)
    first = next(placed, None)
    return (0.0, 0.0, 0.0) if first is None else (first.x / 1e7, first.y / 1e7, 0.0)


def _simple(number: int, item: PlanItem) -> dict[str, Any]:
    where = [item.x, item.y] if item.frame == MISSION_FRAME else _degrees(item)
    return {
        "type": "SimpleItem",
        "command": item.command,
        "frame": item.frame,
        "params": [*item.params, *where, item.z],
        "autoContinue": item.autocontinue,
        "doJumpId": number,
    }


def _degrees(item: PlanItem) -> list[float]:
    return [item.x / 1e7, item.y / 1e7]


def _point(number: int, item: PlanItem) -> list[float | None]:
    """A rally point. The format has heights above home only; raises PayloadError for another frame."""
    if item.frame != RELATIVE:
        raise PayloadError(f"rallyPoints point {number}: expected a height above home, got MAV_FRAME {item.frame}")
    return [*_degrees(item), item.z]


def _fence(items: tuple[PlanItem, ...]) -> dict[str, Any]:
    """The geofence. A polygon's corners are consecutive items, and each gives their count."""
    polygons, circles, back = [], [], None
    left = list(items)
    while left:
        item = left.pop(0)
        if item.command in (INCLUSION_CIRCLE, EXCLUSION_CIRCLE):
            circle = {"center": _degrees(item), "radius": item.params[0]}
            circles.append({"circle": circle, "inclusion": item.command == INCLUSION_CIRCLE, "version": 1})
        elif item.command == FENCE_RETURN:
            back = [*_degrees(item), item.z]
        else:
            count = round(item.params[0] or 0)
            corners, left = [item, *left[: count - 1]], left[count - 1 :]
            if len(corners) != count or any(corner.command != item.command for corner in corners):
                raise PayloadError("geoFence: expected polygons whose corners follow each other")
            inclusion = item.command == INCLUSION_VERTEX
            polygons.append({"polygon": [_degrees(at) for at in corners], "inclusion": inclusion, "version": 1})
    fence: dict[str, Any] = {"version": 2, "polygons": polygons, "circles": circles}
    return fence if back is None else {**fence, "breachReturn": back}
