"""The fleet to fly: that of services/fleet.yaml or of another file (FLEET), or one with FOGS and DRONES."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from functools import cache
from ipaddress import IPv4Network
from pathlib import Path
from typing import Any

from sitl.px4.parameters import SPECS

from ..errors import UserError
from .documents import ROOT, read_document, shown
from .fleet import MOST_DRONES, Fleet
from .typed import whole_number

FLEET_FILE = ROOT / "services" / "fleet.yaml"
SCHEMA_FILE = ROOT / "services" / "fleet.schema.json"
_KEPT_FREE = IPv4Network("198.19.255.0/24")
"""A node looks up the route to an address in it, to check that it leads over `net` (services/entrypoint)."""
_ROOM = IPv4Network("198.18.0.0/15")
_APART_M, _A_ROW, _TO_POINT_M = 120.0, 16, 60.0
"""Additional drones stand in rows: their distance, drones per row, and how far north and east each one's point is.
Sensors have a range of 50 m."""
_NORTH_DEG = 0.003
_METRES_A_DEGREE = 111_320.0


@cache
def standard_fleet() -> Fleet:
    """The experiments' fleet, from which compose.yaml is made. Raises UserError as `read_fleet`."""
    return read_fleet(FLEET_FILE)


def read_fleet(path: Path) -> Fleet:
    """Read the fleet of a file. Raises UserError that names file, field, value and what was expected."""
    found = read_document(path, SCHEMA_FILE)
    where = shown(path)
    networks = {}
    for name, text in found["addresses"].items():
        try:
            networks[name] = IPv4Network(text)
        except ValueError as error:
            raise UserError(f"{where}: addresses.{name}: {text!r}: expected a network ({error})") from error
    # For a schema 1.0 is an integer, too.
    fogs = {int(fog): tuple(map(int, drones)) for fog, drones in found["fogs"].items()}
    drones = {
        int(drone): entry | {"endurance_s": int(entry["endurance_s"])} for drone, entry in found["drones"].items()
    }
    for drone, times in Counter(drone for of_fog in fogs.values() for drone in of_fog).items():
        if times > 1:
            raise UserError(f"{where}: fogs: drone {drone} is there {times} times: expected each drone once")
        if drone not in drones:
            raise UserError(f"{where}: drones.{drone}: missing: expected an entry for each drone of a fog")
    fleet = Fleet(fogs, networks, drones, found.get("parameters", {}), found["sensor_range_m"])
    _check_addresses(fleet, f"{where}: addresses", "another one for it")
    _check_parameters(found.get("parameters", {}), f"{where}: parameters")
    for drone, entry in drones.items():
        _check_parameters(entry.get("parameters", {}), f"{where}: drones.{drone}.parameters")
    return fleet


def fleet_of(environment: Mapping[str, str]) -> Fleet:
    """The fleet that FLEET, FOGS and DRONES ask for; the experiments' fleet if none is set.

    Fogs and drones are numbered from 1; the first fogs have one drone more if they cannot all have the same number.
    Raises UserError that names the variable, its value and what was expected, or as `read_fleet`.
    """
    named = environment.get("FLEET")
    fleet = read_fleet(Path(named).expanduser()) if named else standard_fleet()
    asked = {name: environment[name] for name in ("FOGS", "DRONES") if environment.get(name)}
    if not asked:
        return fleet
    drones = whole_number("DRONES", asked.get("DRONES", str(len(fleet.fog_of))), MOST_DRONES)
    few = " and no more fogs than drones"
    fogs = whole_number("FOGS", asked.get("FOGS", str(min(drones, len(fleet.fogs)))), drones, also=few)
    sizes = [drones // fogs + (place < drones % fogs) for place in range(fogs)]
    spread = {fog: tuple(range(sum(sizes[: fog - 1]) + 1, sum(sizes[:fog]) + 1)) for fog in range(1, fogs + 1)}
    entries = {drone: fleet.drones.get(drone) or _further(fleet, drone) for drone in range(1, drones + 1)}
    resized = Fleet(spread, fleet.networks, entries, fleet.parameters, fleet.sensor_range_m)
    where = " ".join(f"{name}={value}" for name, value in asked.items())
    _check_addresses(resized, where, "fewer, or other addresses in a file (FLEET)")
    return resized


def suffix(environment: Mapping[str, str]) -> str:
    """The part of the results' path for another fleet than the experiments', as `+fogs-3+drones-12`; else empty."""
    fleet, named = fleet_of(environment), environment.get("FLEET")
    if fleet == standard_fleet():
        return ""
    return (f"+fleet-{Path(named).stem}" if named else "") + f"+fogs-{len(fleet.fogs)}+drones-{len(fleet.fog_of)}"


def _further(fleet: Fleet, drone: int) -> dict[str, Any]:
    """A drone that the file does not have: a copy of one of the file's, taken in turn, at a place north of all."""
    known = [fleet.drones[number] for number in sorted(fleet.drones)]
    like = known[(drone - 1) % len(known)]
    places = [place for entry in known for place in (entry, entry["point"])]
    row, column = divmod(drone - 1, _A_ROW)
    latitude_deg = max(place["latitude_deg"] for place in places) + _NORTH_DEG
    longitude_deg = min(place["longitude_deg"] for place in places)
    a_north, an_east = 1 / _METRES_A_DEGREE, 1 / (_METRES_A_DEGREE * math.cos(math.radians(latitude_deg)))
    home = (latitude_deg + row * _APART_M * a_north, longitude_deg + column * _APART_M * an_east)
    point = (home[0] + _TO_POINT_M * a_north, home[1] + _TO_POINT_M * an_east)
    return {**like, **_place(*home), "point": {**like["point"], **_place(*point)}}


def _place(latitude_deg: float, longitude_deg: float) -> dict[str, float]:
    return {"latitude_deg": round(latitude_deg, 6), "longitude_deg": round(longitude_deg, 6)}


def _check_addresses(fleet: Fleet, where: str, expected: str) -> None:
    """Raise UserError that names the first node whose network overlaps another's, or is outside of `_ROOM`."""
    taken = {_KEPT_FREE: "kept free"}
    for node in fleet.nodes(sensors=True):
        network = fleet.network(node)
        if not network.subnet_of(_ROOM):
            raise UserError(f"{where}: {node} would be in {network}, which is outside of {_ROOM}: expected {expected}")
        other = next((name for there, name in taken.items() if network.overlaps(there)), None)
        if other is not None:
            raise UserError(f"{where}: {node} would be in {network}, which is {other}: expected {expected}")
        taken[network] = f"{node}'s"


def _check_parameters(parameters: Mapping[str, float], where: str) -> None:
    """Raise UserError for a parameter that the autopilots' stand-ins do not have, or for a value out of its range."""
    for name, value in parameters.items():
        if name not in SPECS:
            raise UserError(f"{where}.{name}: {value}: unknown parameter: expected one of {', '.join(SPECS)}")
        if not SPECS[name].low <= value <= SPECS[name].high:
            raise UserError(f"{where}.{name}: {value}: expected {SPECS[name].low:g} to {SPECS[name].high:g}")
