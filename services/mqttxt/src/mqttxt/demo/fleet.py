"""The demo's drones: position, battery and speed of each; and the places around them."""

from __future__ import annotations

import json
from dataclasses import dataclass

FOG = 1
_PARAMETERS = "{COM_DISARM_PRFLT: 60, RTL_RETURN_ALT: 15, MIS_TAKEOFF_ALT: 10}"
"""The parameters of all drones, with PX4's names. PX4's default of 10 s between arm and takeoff is short for typing."""


@dataclass(frozen=True)
class Simulated:
    """One drone. Its largest speed is also its cruising speed, so that it arrives when a ranking predicts it."""

    latitude_deg: float
    longitude_deg: float
    capacity_wh: float
    charge_pct: float
    speed_m_s: float
    endurance_s: int
    """Flight time of a full battery."""


DRONES = {
    1: Simulated(47.397742, 8.545594, 70, 100, 12, 790),
    2: Simulated(47.397742, 8.546126, 64, 96, 10, 760),
    3: Simulated(47.398102, 8.545594, 70, 88, 14, 750),
    4: Simulated(47.398102, 8.546126, 60, 97, 11, 700),
}
"""By number. All differ, so that a ranking has something to rank."""

PLACES = {
    "Church": (47.39850, 8.54700),
    "Farm": (47.39870, 8.54480),
    "Football pitch": (47.39770, 8.54430),
    "Mill": (47.39680, 8.54530),
    "Bridge": (47.39700, 8.54720),
}
"""Invented places by name, in degrees north and east."""


def fleet_file() -> str:
    """The drones as YAML, for the autopilot stand-in."""
    lines = [f"parameters: {_PARAMETERS}", "drones:"]
    for number, drone in DRONES.items():
        place = f"latitude_deg: {drone.latitude_deg}, longitude_deg: {drone.longitude_deg}, altitude_m: 488.0"
        battery = f"capacity_wh: {drone.capacity_wh}, charge_pct: {drone.charge_pct}"
        speed = f"parameters: {{MPC_XY_VEL_MAX: {drone.speed_m_s}, MPC_XY_CRUISE: {drone.speed_m_s}}}"
        lines.append(f"  {number}: {{{place}, {battery}, {speed}}}")
    return "\n".join(lines) + "\n"


def places_file() -> str:
    """The places as GeoJSON, for the page."""
    points = [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": {"type": "Point", "coordinates": [longitude_deg, latitude_deg]},
        }
        for name, (latitude_deg, longitude_deg) in PLACES.items()
    ]
    return json.dumps({"type": "FeatureCollection", "features": points})
