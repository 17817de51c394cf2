"""Fogs and drones as the browser is sent them."""

from __future__ import annotations

from typing import Any

from ..protocol.names import in_fleet
from ..protocol.states import STATES, AutopilotText
from ..station.views import Drone, Fog
from .event_log import as_plain

STALE_MS = 45_000
"""An older value looks stale: it should have come again (R3.5), and no choice goes by it (R7.3)."""
_LEFT_OUT = AutopilotText.name


def name_of(fog: Fog) -> int | str:
    """A fog as pages name it: its number, and of several fleets a text as `acme/1`."""
    return in_fleet(fog.fleet, fog.number) if fog.fleet else fog.number


def fog_of(fog: Fog) -> dict[str, Any]:
    """A fog, and whether it is heard."""
    return {"fog": name_of(fog), "live": fog.is_live, "drones": len(fog.drones)}


def drone_of(fog: Fog, drone: Drone) -> dict[str, Any]:
    """A drone with every state that is known, each with its age; texts are in the log."""
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
    """What changes by time alone, without an event."""
    return drone.is_reachable, drone.holder, drone.is_controlled
