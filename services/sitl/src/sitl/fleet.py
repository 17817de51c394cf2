"""The fleet's configuration: each drone's place, battery and parameters, read from YAML and checked."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from .dynamics import Place
from .errors import SitlError
from .px4.parameters import SPECS

_RANGES = {
    "latitude_deg": (-90, 90),
    "longitude_deg": (-180, 180),
    "altitude_m": (-500, 9000),
    "capacity_wh": (1, 10_000),
    "charge_pct": (0, 100),
}
_OF_MISSIONS = {"endurance_s", "point"}
"""A drone's fields in the fleet's file that other programs read and check."""
_SECTIONS = ("fogs", "addresses", "sensor_range_m", "parameters", "drones")

ZURICH = Place(47.397742, 8.545594, 488.0)
"""Where PX4's simulations start."""


@dataclass(frozen=True)
class DroneConfig:
    """One drone: its home, its battery's capacity and charge, and its parameters other than PX4's defaults."""

    system_id: int
    home: Place = ZURICH
    capacity_wh: float | None = None
    """None: PX4's simulated battery."""
    charge_pct: float = 100.0
    parameters: dict[str, float] = field(default_factory=dict)
    quiet: bool = False
    """Whether its telemetry is without noise."""


def load(path: Path, system_id: int) -> DroneConfig:
    """Read the configuration of one drone. Raises SitlError naming file, field, value and expectation."""
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SitlError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SitlError(f"{path}: not UTF-8 text") from error
    except yaml.YAMLError as error:
        raise SitlError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict) or not isinstance(document.get("drones"), dict):
        raise SitlError(f"{path}: drones: expected a mapping of numbers to drones")
    unknown = set(document) - {*_SECTIONS}
    if unknown:
        raise SitlError(f"{path}: {', '.join(map(str, unknown))}: expected {', '.join(_SECTIONS)} only")
    if system_id not in document["drones"]:
        known = ", ".join(str(number) for number in document["drones"])
        raise SitlError(f"{path}: drones: no drone {system_id}; expected one of {known}")
    shared = _parameters(path, "parameters", document.get("parameters") or {})
    return _drone(path, system_id, document["drones"][system_id], shared)


def _drone(path: Path, system_id: int, entry: Any, shared: dict[str, float]) -> DroneConfig:
    where = f"drones.{system_id}"
    if not isinstance(entry, dict):
        raise SitlError(f"{path}: {where}: expected a mapping, got {entry!r}")
    unknown = set(entry) - {*_RANGES, *_OF_MISSIONS, "parameters"}
    missing = set(_RANGES) - set(entry)
    if unknown or missing:
        names = ", ".join(sorted(str(name) for name in unknown or missing))
        raise SitlError(f"{path}: {where}: {names} {'is not known' if unknown else 'is missing'}")
    numbers = {name: _number(path, f"{where}.{name}", entry[name], *_RANGES[name]) for name in _RANGES}
    own = _parameters(path, f"{where}.parameters", entry.get("parameters") or {})
    home = Place(numbers["latitude_deg"], numbers["longitude_deg"], numbers["altitude_m"])
    return DroneConfig(system_id, home, numbers["capacity_wh"], numbers["charge_pct"], {**shared, **own})


def _parameters(path: Path, where: str, entry: Any) -> dict[str, float]:
    if not isinstance(entry, dict):
        raise SitlError(f"{path}: {where}: expected a mapping of names to numbers, got {entry!r}")
    for name in entry:
        if name not in SPECS:
            raise SitlError(f"{path}: {where}.{name}: expected one of {', '.join(SPECS)}")
    return {
        name: _number(path, f"{where}.{name}", value, SPECS[name].low, SPECS[name].high)
        for name, value in entry.items()
    }


def _number(path: Path, where: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise SitlError(f"{path}: {where}: expected a number from {low:g} to {high:g}, got {value!r}")
    return float(value)
