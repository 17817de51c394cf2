"""Reads QGroundControl's plan file into a drone's lists; names each mistake by list, item and field."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

from ..errors import PlanMistakes
from ..protocol.fields import FLOAT32_MAX
from ..protocol.plans import MOST_ITEMS, PlanItem, PlanObject
from ..protocol.values import shown

GLOBAL, MISSION_FRAME, RELATIVE, TERRAIN = 0, 2, 3, 10
"""MAV_FRAMEs that QGroundControl writes: above mean sea level, without a place, above home, above the ground."""
FENCE_RETURN, INCLUSION_VERTEX, EXCLUSION_VERTEX, INCLUSION_CIRCLE, EXCLUSION_CIRCLE = range(5000, 5005)
RALLY_POINT, DO_JUMP = 5100, 177
"""MAV_CMDs."""
_FLAT = ("survey", "CorridorScan")
"""Complex items that QGroundControl writes together with the simple items they consist of."""
_NOTHING = PlanItem(GLOBAL, 0, (None,) * 4, 0, 0, None, False)
"""Stands for an item with a mistake."""
Place = tuple[int, int]


def read(document: Any) -> tuple[PlanObject, tuple[float, float, float] | None]:
    """The lists of a plan and the home that it expects; raises PlanMistakes, with a line for each mistake."""
    mistakes: list[str] = []
    found = _read(_part("plan", document, mistakes))
    if mistakes:
        raise PlanMistakes(mistakes)
    return found


def _read(plan: _Part) -> tuple[PlanObject, tuple[float, float, float] | None]:
    if not plan.is_of("fileType", "Plan") or not plan.is_of("version", 1):
        return PlanObject(), None
    mission = plan.part("mission", "mission")
    home = mission.optional("plannedHomePosition")
    return PlanObject(
        mission=_mission(mission),
        fence=_fence(plan.part("geoFence", "geoFence")) if plan.optional("geoFence") is not None else None,
        rally=_rally(plan.part("rallyPoints", "rallyPoints")) if plan.optional("rallyPoints") is not None else None,
    ), None if home is None else _point(home, "mission: plannedHomePosition", mission.mistakes)


@dataclass(frozen=True)
class _Part:
    """A JSON object of the file; `where` is its name in errors.

    Each mistake in it is entered in `mistakes`, and reading goes on with a harmless value: where there is any mistake,
    the result is not used.
    """

    where: str
    value: dict[str, Any]
    mistakes: list[str]

    def refuse(self, field: str, expected: str, got: object) -> None:
        _refuse(f"{self.where}{f': {field}' if field else ''}", expected, got, self.mistakes)

    def optional(self, field: str) -> Any:
        return self.value.get(field)

    def is_of(self, field: str, *values: Any) -> bool:
        """Whether a field has one of these values; anything else is a mistake."""
        found = self.value.get(field)
        is_right = found in values and not isinstance(found, bool)
        if not is_right:
            self.refuse(field, " or ".join(map(repr, values)), found)
        return is_right

    def whole(self, field: str, low: int, high: int) -> int | None:
        found = self.value.get(field)
        if type(found) is not int or not low <= found <= high:
            self.refuse(field, f"a whole number from {low} to {high}", found)
            return None
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
            return []
        if len(found) > MOST_ITEMS:
            self.refuse(field, f"at most {MOST_ITEMS}", len(found))
            return []
        return list(found)

    def part(self, field: str, where: str) -> _Part:
        return _part(where, self.value.get(field), self.mistakes)


def _part(where: str, value: Any, mistakes: list[str]) -> _Part:
    """A part of the file. Of one that is no object, no other mistake is reported."""
    if isinstance(value, dict):
        return _Part(where, value, mistakes)
    _refuse(where, "an object", value, mistakes)
    return _Part(where, {}, [])


def _refuse(where: str, expected: str, got: object, mistakes: list[str]) -> None:
    mistakes.append(f"{where}: expected {expected}, got {shown(got)}")


def _mission(mission: _Part) -> tuple[PlanItem, ...]:
    if not mission.is_of("version", 2):
        return ()
    simple, are_all = _flattened(mission)
    if len(simple) > MOST_ITEMS:
        mission.refuse("items", f"at most {MOST_ITEMS}", len(simple))
        return ()
    numbers = _jump_numbers(simple)
    return tuple(_item(item, numbers if are_all else None) for item in simple)


def _jump_numbers(items: list[_Part]) -> dict[int, int]:
    """The numbers of the items that can be jumped to, by `doJumpId`; an id of two items is left out."""
    found: dict[int, list[int]] = {}
    for number, item in enumerate(items, start=1):
        jump_id = item.whole("doJumpId", 0, 2**31 - 1) if item.optional("doJumpId") is not None else None
        if jump_id is not None:
            found.setdefault(jump_id, []).append(number)
    return {jump_id: numbers[0] for jump_id, numbers in found.items() if len(numbers) == 1}


def _flattened(mission: _Part) -> tuple[list[_Part], bool]:
    """The simple items in their order, including those of complex items, and whether these are all.

    Each is named by its number from 1. After an item of unknown length no item has a number, so reading ends there.
    """
    simple: list[_Part] = []
    for value in mission.array("items"):
        if len(simple) > MOST_ITEMS:
            break  # no drone takes them, and each may have mistakes
        item = _part(f"mission item {len(simple) + 1}", value, mission.mistakes)
        if not item.is_of("type", "SimpleItem", "ComplexItem"):
            return simple, False
        if item.value["type"] == "SimpleItem":
            simple.append(item)
            continue
        kind = item.optional("complexItemType")
        if kind not in _FLAT:
            item.refuse("complexItemType", f"{' or '.join(_FLAT)}, which have their items in the file", kind)
            return simple, False
        style = item.part("TransectStyleComplexItem", f"{item.where}: TransectStyleComplexItem")
        inner = style.array("Items")
        if not isinstance(style.optional("Items"), list):
            return simple, False
        for one in inner:
            part = _part(f"mission item {len(simple) + 1} ({kind})", one, mission.mistakes)
            part.is_of("type", "SimpleItem")
            simple.append(part)
    return simple, True


def _item(item: _Part, numbers: dict[int, int] | None) -> PlanItem:
    """Read an item. `numbers` has the items that can be jumped to by their `doJumpId`, None if they are not known."""
    mistakes = item.mistakes
    is_framed = item.is_of("frame", GLOBAL, MISSION_FRAME, RELATIVE, TERRAIN)
    frame = item.value["frame"] if is_framed else None
    command = item.whole("command", 0, 2**16 - 1)
    if command is not None and command not in _commands():
        item.refuse("command", "a MAV_CMD of common.xml", command)
    goes_on = item.flag("autoContinue")
    params = item.array("params")
    if len(params) != 7:
        if isinstance(item.optional("params"), list):
            item.refuse("params", "seven", len(params))
        return _NOTHING
    where = [f"{item.where}: params[{place}]" for place in range(7)]
    four = [_number(param, place, mistakes) for param, place in zip(params[:4], where, strict=False)]
    if frame == MISSION_FRAME:
        x, y = (_whole(_number(params[place], where[place], mistakes), where[place], mistakes) for place in (4, 5))
        z = _number(params[6], where[6], mistakes)
    elif frame is not None:
        x, y = _place(params[4], params[5], where[4], where[5], mistakes)
        z = _finite(params[6], where[6], mistakes)
    else:
        return _NOTHING
    if command == DO_JUMP and numbers is not None and params[0] == four[0]:  # else it is a mistake already
        jump_id = four[0]
        if jump_id is None or jump_id not in numbers:
            item.refuse("params[0]", "the doJumpId of one item", params[0])
        else:
            four[0] = float(numbers[int(jump_id)])
    return PlanItem(frame, command or 0, tuple(four), x, y, z, goes_on)


def _fence(fence: _Part) -> tuple[PlanItem, ...]:
    if not fence.is_of("version", 2):
        return ()
    items: list[PlanItem] = []
    for number, value in enumerate(fence.array("polygons"), start=1):
        if len(items) > MOST_ITEMS:
            break
        polygon = _part(f"geoFence polygon {number}", value, fence.mistakes)
        corners = polygon.array("polygon")
        found = polygon.optional("polygon")
        if isinstance(found, list) and len(found) < 3:
            polygon.refuse("polygon", "three corners or more", len(found))
        command = INCLUSION_VERTEX if polygon.flag("inclusion") else EXCLUSION_VERTEX
        for corner, at in enumerate(corners, start=1):
            place = _pair(at, f"{polygon.where}: corner {corner}", polygon.mistakes)
            items.append(_of_fence(command, len(corners), *place))
    for number, value in enumerate(fence.array("circles"), start=1):
        circle = _part(f"geoFence circle {number}", value, fence.mistakes)
        shape = circle.part("circle", circle.where)
        radius_m = _finite(shape.optional("radius"), f"{circle.where}: radius", shape.mistakes, above_m=0)
        command = INCLUSION_CIRCLE if circle.flag("inclusion") else EXCLUSION_CIRCLE
        place = _pair(shape.optional("center"), f"{circle.where}: center", shape.mistakes)
        items.append(_of_fence(command, radius_m, *place))
    back = fence.optional("breachReturn")
    if back is not None:
        latitude, longitude, altitude_m = _point(back, "geoFence: breachReturn", fence.mistakes)
        x, y = round(latitude * 1e7), round(longitude * 1e7)
        items.append(PlanItem(RELATIVE, FENCE_RETURN, (0.0, 0.0, 0.0, 0.0), x, y, altitude_m, False))
    return tuple(items)


def _of_fence(command: int, param: float, x: int, y: int) -> PlanItem:
    return PlanItem(GLOBAL, command, (float(param), 0.0, 0.0, 0.0), x, y, 0.0, False)


def _rally(rally: _Part) -> tuple[PlanItem, ...]:
    if not rally.is_of("version", 2):
        return ()
    items = []
    for number, point in enumerate(rally.array("points"), start=1):
        latitude, longitude, altitude_m = _point(point, f"rallyPoints point {number}", rally.mistakes)
        x, y = round(latitude * 1e7), round(longitude * 1e7)
        items.append(PlanItem(RELATIVE, RALLY_POINT, (0.0, 0.0, 0.0, 0.0), x, y, altitude_m, False))
    return tuple(items)


def _point(value: Any, where: str, mistakes: list[str]) -> tuple[float, float, float]:
    """Latitude, longitude, altitude."""
    if not isinstance(value, list) or len(value) != 3:
        _refuse(where, "[latitude, longitude, altitude]", value, mistakes)
        return 0.0, 0.0, 0.0
    x, y = _place(value[0], value[1], where, where, mistakes)
    return x / 1e7, y / 1e7, _finite(value[2], f"{where}: altitude", mistakes)


def _pair(value: Any, where: str, mistakes: list[str]) -> Place:
    if not isinstance(value, list) or len(value) != 2:
        _refuse(where, "[latitude, longitude]", value, mistakes)
        return 0, 0
    return _place(value[0], value[1], where, where, mistakes)


def _place(latitude: Any, longitude: Any, where_latitude: str, where_longitude: str, mistakes: list[str]) -> Place:
    """Latitude and longitude as MAVLink has them: degrees times 1e7."""
    sides = ((latitude, 90, "latitude", where_latitude), (longitude, 180, "longitude", where_longitude))
    place = [0, 0]
    for side, (value, most, what, where) in enumerate(sides):
        if type(value) not in (int, float) or not abs(value) <= most:
            _refuse(where, f"a {what} from -{most} to {most} degrees", value, mistakes)
        else:
            place[side] = round(value * 1e7)
    return place[0], place[1]


def _number(value: Any, where: str, mistakes: list[str]) -> float | None:
    """A parameter; null means that it is not set."""
    if value is None:
        return None
    return _finite(value, where, mistakes)


def _finite(value: Any, where: str, mistakes: list[str], above_m: float | None = None) -> float:
    if type(value) not in (int, float) or not abs(value) <= FLOAT32_MAX:
        _refuse(where, "a number", value, mistakes)
        return 0.0
    if above_m is not None and not value > above_m:
        _refuse(where, f"metres above {above_m:g}", value, mistakes)
    return float(value)


def _whole(value: float | None, where: str, mistakes: list[str]) -> int:
    """A parameter that MAVLink carries as a whole number of 32 bits; 0 where it is not set."""
    if value is None:
        return 0
    if not math.isclose(value, round(value)) or not -(2**31) <= round(value) < 2**31:
        _refuse(where, "a whole number of 32 bits", value, mistakes)
        return 0
    return round(value)


@cache
def _commands() -> frozenset[int]:
    from pymavlink.dialects.v20 import common as mavlink

    return frozenset(mavlink.enums["MAV_CMD"])
