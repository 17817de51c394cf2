"""Fogs and drones as the browser gets them."""

from __future__ import annotations

from typing import Any

from ..protocol.names import in_fleet
from ..protocol.states import STATES, AutopilotText
from ..station.views import Drone, Fog
from .event_log import as_plain

_LEFT_OUT = AutopilotText.name


def name_of(fog: Fog) -> int | str:
    """A fog as pages name it: its number, or among several fleets a text such as `acme/1`."""
    return in_fleet(fog.fleet, fog.number) if fog.fleet else fog.number


def fog_of(fog: Fog) -> dict[str, Any]:
    """A fog, whether it is live, and its number of drones."""
    return {"fog": name_of(fog), "live": fog.is_live, "drones": len(fog.drones)}


def drone_of(fog: Fog, drone: Drone) -> dict[str, Any]:
    """A drone with every known state and its age; texts are in the log."""
    return {
        "fleet": fog.fleet,
        "fog": name_of(fog),
        "drone": drone.number,
        "reachable": drone.is_reachable,
        "holder": drone.holder,
        "mine": drone.is_controlled,
        "states": {
            name: {"age_ms": known.age_ms, **as_plain(known.state)}
            for name, known in drone.states.items()
            if name in STATES and name != _LEFT_OUT
        },
    }


def standing_of(drone: Drone) -> tuple[bool, str | None, bool]:
    """The values that can change with time alone, without an event."""
    return drone.is_reachable, drone.holder, drone.is_controlled
