"""From QGroundControl's plan file to a drone's lists; whatever is wrong is named by list, item and field."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from ..errors import PayloadError
from ..protocol.plans import MOST_ITEMS, PlanItem, PlanObject
from ..protocol.values import shown

GLOBAL, MISSION_FRAME, RELATIVE, TERRAIN = 0, 2, 3, 10
"""MAV_FRAMEs that QGroundControl writes: above mean sea level, without a place, above home, above the ground."""
FENCE_RETURN, INCLUSION_VERTEX, EXCLUSION_VERTEX, INCLUSION_CIRCLE, EXCLUSION_CIRCLE = range(5000, 5005)
RALLY_POINT, DO_JUMP = 5100, 177
"""MAV_CMDs."""
_FLAT = ("survey", "CorridorScan")
"""Complex items that QGroundControl writes with the items they consist of."""
_LARGEST = 3.4028234663852886e38
Place = tuple[int, int]


def read(document: Any) -> tuple[PlanObject, tuple[float, float, float] | None]:
    """The lists of a plan and the home that it expects; raises PayloadError."""
    plan = _Part("plan", document)
    plan.one_of("fileType", "Plan")
    plan.one_of("version", 1)
    mission = plan.part("mission", "mission")
    mission.one_of("version", 2)
    home = mission.optional("plannedHomePosition")
    return PlanObject(
        mission=_mission(mission),
        fence=_fence(plan.part("geoFence", "geoFence")) if plan.optional("geoFence") is not None else None,
        rally=_rally(plan.part("rallyPoints", "rallyPoints")) if plan.optional("rallyPoints") is not None else None,
    ), None if home is None else _point(home, "mission: plannedHomePosition")


@dataclass(frozen=True)
class _Part:
    """An object of the file, and how people find it."""

    where: str
    value: Any

    def __post_init__(self) -> None:
        if not isinstance(self.value, dict):
            self.refuse("", "an object", self.value)

    def refuse(self, field: str, expected: str, got: object) -> None:
        raise PayloadError(f"{self.where}{f': {field}' if field else ''}: expected {expected}, got {shown(got)}")

    def optional(self, field: str) -> Any:
        return self.value.get(field)

    def one_of(self, field: str, *values: Any) -> Any:
        found = self.value.get(field)
        if found not in values or isinstance(found, bool):
            self.refuse(field, " or ".join(map(repr, values)), found)
        return found

    def whole(self, field: str, low: int, high: int) -> int:
        found = self.value.get(field)
        if type(found) is not int or not low <= found <= high:
            self.refuse(field, f"a whole number from {low} to {high}", found)
        return int(found)

    def flag(self, field: str) -> bool:
        found = self.value.get(field)
        if type(found) is not bool:
            self.refuse(field, "true or false", found)
        return bool(found)

    def array(self, field: str) -> list[Any]:
        found = self.value.get(field)
        if not isinstance(found, list):
            self.refuse(field, "a list", found)
        return list(found)

    def part(self, field: str, where: str) -> _Part:
        return _Part(where, self.value.get(field))


def _mission(mission: _Part) -> tuple[PlanItem, ...]:
    simple = list(_flattened(mission))
    if len(simple) > MOST_ITEMS:
        mission.refuse("items", f"at most {MOST_ITEMS}", len(simple))
    numbers = _jump_numbers(simple)
    return tuple(_item(item, numbers) for item in simple)


def _jump_numbers(items: list[_Part]) -> dict[int, int]:
    """The items that can be jumped to, by their `doJumpId`: of two with one, neither."""
    found: dict[int, list[int]] = {}
    for number, item in enumerate(items, start=1):
        if item.optional("doJumpId") is not None:
            found.setdefault(item.whole("doJumpId", 0, 2**31 - 1), []).append(number)
    return {jump_id: numbers[0] for jump_id, numbers in found.items() if len(numbers) == 1}


def _flattened(mission: _Part) -> Iterator[_Part]:
    """The simple items in their order, those of complex ones among them, each by its number from 1."""
    number = 1
    for value in mission.array("items"):
        item = _Part(f"mission item {number}", value)
        if item.one_of("type", "SimpleItem", "ComplexItem") == "SimpleItem":
            yield item
            number += 1
            continue
        kind = item.optional("complexItemType")
        if kind not in _FLAT:
            item.refuse("complexItemType", f"{' or '.join(_FLAT)}, which have their items in the file", kind)
        style = item.part("TransectStyleComplexItem", f"{item.where}: TransectStyleComplexItem")
        for inner in style.array("Items"):
            part = _Part(f"mission item {number} ({kind})", inner)
            part.one_of("type", "SimpleItem")
            yield part
            number += 1


def _item(item: _Part, numbers: dict[int, int]) -> PlanItem:
    frame = item.one_of("frame", GLOBAL, MISSION_FRAME, RELATIVE, TERRAIN)
    command = item.whole("command", 0, 2**16 - 1)
    if command not in _commands():
        item.refuse("command", "a MAV_CMD of common.xml", command)
    params = item.array("params")
    if len(params) != 7:
        item.refuse("params", "seven", len(params))
    four = [_number(param, f"{item.where}: params[{place}]") for place, param in enumerate(params[:4])]
    if command == DO_JUMP:
        if params[0] not in numbers:
            item.refuse("params[0]", "the doJumpId of one item", params[0])
        four[0] = float(numbers[params[0]])
    if frame == MISSION_FRAME:
        x, y, z = (_number(param, f"{item.where}: params[{place}]") for place, param in enumerate(params[4:], start=4))
        found = (_whole(x, f"{item.where}: params[4]"), _whole(y, f"{item.where}: params[5]"))
    else:
        found = _place(params[4], params[5], f"{item.where}: params[4]", f"{item.where}: params[5]")
        z = _finite(params[6], f"{item.where}: params[6]")
    return PlanItem(frame, command, tuple(four), *found, z, item.flag("autoContinue"))


def _fence(fence: _Part) -> tuple[PlanItem, ...]:
    fence.one_of("version", 2)
    items: list[PlanItem] = []
    for number, value in enumerate(fence.array("polygons"), start=1):
        polygon = _Part(f"geoFence polygon {number}", value)
        corners = polygon.array("polygon")
        if len(corners) < 3:
            polygon.refuse("polygon", "three corners or more", len(corners))
        command = INCLUSION_VERTEX if polygon.flag("inclusion") else EXCLUSION_VERTEX
        for corner, at in enumerate(corners, start=1):
            items.append(_of_fence(command, len(corners), *_pair(at, f"{polygon.where}: corner {corner}")))
    for number, value in enumerate(fence.array("circles"), start=1):
        circle = _Part(f"geoFence circle {number}", value)
        shape = circle.part("circle", circle.where)
        radius_m = _finite(shape.optional("radius"), f"{circle.where}: radius")
        if not radius_m > 0:
            circle.refuse("radius", "metres above 0", radius_m)
        command = INCLUSION_CIRCLE if circle.flag("inclusion") else EXCLUSION_CIRCLE
        items.append(_of_fence(command, radius_m, *_pair(shape.optional("center"), f"{circle.where}: center")))
    back = fence.optional("breachReturn")
    if back is not None:
        latitude, longitude, altitude_m = _point(back, "geoFence: breachReturn")
        x, y = round(latitude * 1e7), round(longitude * 1e7)
        items.append(PlanItem(RELATIVE, FENCE_RETURN, (0.0, 0.0, 0.0, 0.0), x, y, altitude_m, False))
    return tuple(items)


def _of_fence(command: int, param: float, x: int, y: int) -> PlanItem:
    return PlanItem(GLOBAL, command, (float(param), 0.0, 0.0, 0.0), x, y, 0.0, False)


def _rally(rally: _Part) -> tuple[PlanItem, ...]:
    rally.one_of("version", 2)
    items = []
    for number, point in enumerate(rally.array("points"), start=1):
        latitude, longitude, altitude_m = _point(point, f"rallyPoints point {number}")
        x, y = round(latitude * 1e7), round(longitude * 1e7)
        items.append(PlanItem(RELATIVE, RALLY_POINT, (0.0, 0.0, 0.0, 0.0), x, y, altitude_m, False))
    return tuple(items)


def _point(value: Any, where: str) -> tuple[float, float, float]:
    """Latitude, longitude, altitude."""
    if not isinstance(value, list) or len(value) != 3:
        raise PayloadError(f"{where}: expected [latitude, longitude, altitude], got {shown(value)}")
    x, y = _place(value[0], value[1], where, where)
    return x / 1e7, y / 1e7, _finite(value[2], f"{where}: altitude")


def _pair(value: Any, where: str) -> Place:
    if not isinstance(value, list) or len(value) != 2:
        raise PayloadError(f"{where}: expected [latitude, longitude], got {shown(value)}")
    return _place(value[0], value[1], where, where)


def _place(latitude: Any, longitude: Any, where_latitude: str, where_longitude: str) -> Place:
    """Degrees, as MAVLink has them: times 1e7."""
    sides = ((latitude, 90, "latitude", where_latitude), (longitude, 180, "longitude", where_longitude))
    for value, most, what, where in sides:
        if type(value) not in (int, float) or not abs(value) <= most:
            raise PayloadError(f"{where}: expected a {what} from -{most} to {most} degrees, got {shown(value)}")
    return round(latitude * 1e7), round(longitude * 1e7)


def _number(value: Any, where: str) -> float | None:
    """A parameter; null is one that is not set."""
    if value is None:
        return None
    return _finite(value, where)


def _finite(value: Any, where: str) -> float:
    if type(value) not in (int, float) or not abs(value) <= _LARGEST:
        raise PayloadError(f"{where}: expected a number, got {shown(value)}")
    return float(value)


def _whole(value: float | None, where: str) -> int:
    """A parameter that travels as a whole number."""
    if value is None:
        return 0
    if not math.isclose(value, round(value)) or not -(2**31) <= round(value) < 2**31:
        raise PayloadError(f"{where}: expected a whole number of 32 bits, got {shown(value)}")
    return round(value)


@cache
def _commands() -> frozenset[int]:
    from pymavlink.dialects.v20 import common as mavlink

    return frozenset(mavlink.enums["MAV_CMD"])
