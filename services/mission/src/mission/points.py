"""Each UAV's own point, where scenarios 2 and 4 send it: read from points.yaml beside this module."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.resources import files

import yaml

from .fleet import Point


@cache
def all_points() -> dict[int, Point]:
    """Every point by the number of its drone."""
    table = yaml.safe_load(files(__package__).joinpath("points.yaml").read_text(encoding="utf-8"))
    return {int(drone): Point(**entry) for drone, entry in table["points"].items()}


def points_of(drones: Iterable[int]) -> dict[int, Point]:
    """The points of these drones; raises ValueError for one that has none."""
    known = all_points()
    for drone in drones:
        if drone not in known:
            expected = ", ".join(str(number) for number in known)
            raise ValueError(f"drone {drone} has no point in points.yaml: expected drones of {expected}")
    return {drone: known[drone] for drone in drones}
