"""Each UAV's own point, to which scenarios 2 and 4 send it, from the fleet's file."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import yaml

from .fleet import Point

FLEET_FILE = Path(__file__).parents[3] / "fleet.yaml"
"""The experiments' fleet; the environment variable FLEET_FILE names another."""


@cache
def all_points() -> dict[int, Point]:
    """Every point by the number of its drone."""
    path = Path(os.environ.get("FLEET_FILE", FLEET_FILE))
    drones = yaml.safe_load(path.read_text(encoding="utf-8"))["drones"]
    return {int(drone): Point(**entry["point"]) for drone, entry in drones.items()}


def points_of(drones: Iterable[int]) -> dict[int, Point]:
    """The points of these drones. Raises ValueError for a drone without one."""
    known = all_points()
    for drone in drones:
        if drone not in known:
            expected = ", ".join(str(number) for number in known)
            raise ValueError(f"drone {drone} has no point in the fleet's file: expected drones of {expected}")
    return {drone: known[drone] for drone in drones}
