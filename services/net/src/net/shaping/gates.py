"""Links that are open while a drone is near, by the position that its autopilot's stand-in wrote last."""

from __future__ import annotations

import json
import math
from pathlib import Path

from ..emulator.plan import is_number
from ..interfaces import NetError
from ..link_plan import Gate

EARTH_RADIUS_M = 6_371_008.8
"""The mean radius of WGS 84 (IUGG)."""


def distance_m(latitude_deg: float, longitude_deg: float, to_latitude_deg: float, to_longitude_deg: float) -> float:
    """The distance along the ground, by the haversine formula."""
    one, other = math.radians(latitude_deg), math.radians(to_latitude_deg)
    across = math.radians(to_longitude_deg - longitude_deg)
    half = math.sin((other - one) / 2) ** 2 + math.cos(one) * math.cos(other) * math.sin(across / 2) ** 2
    return 2 * EARTH_RADIUS_M * math.asin(min(1.0, math.sqrt(half)))


def position_file(folder: Path, drone: int) -> Path:
    """The file in the run's folder to which a drone's autopilot writes its position."""
    return folder / "sitl" / f"uav{drone}.position.json"


def read_position(path: Path) -> tuple[float, float] | None:
    """Latitude and longitude in degrees; None until there is a first position. Raises NetError if it is invalid."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise NetError(f"{path}: {error.strerror}; expected a position in JSON") from error
    try:
        content = json.loads(text)
        latitude_deg, longitude_deg = content["latitude_deg"], content["longitude_deg"]
    except (ValueError, TypeError, KeyError) as error:
        raise NetError(f"{path}: {text[:80]!r}: expected latitude_deg and longitude_deg in JSON") from error
    for name, value in (("latitude_deg", latitude_deg), ("longitude_deg", longitude_deg)):
        if not is_number(value):
            raise NetError(f"{path}: {name} {value!r}: expected degrees")
    return float(latitude_deg), float(longitude_deg)


def is_open(gate: Gate, position: tuple[float, float] | None) -> bool:
    """Whether a gate is open; a drone without a known position is out of range."""
    return position is not None and distance_m(*position, gate.latitude_deg, gate.longitude_deg) <= gate.range_m
