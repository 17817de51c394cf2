"""Bundles: the states of one drone, or of a fog's drones, in one message (docs/protocol.md, section 10)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from .fields import DroneNumber, Items, Stamp
from .state_payload import StampedState
from .states import STATE, State

MAX_DRONES = 50
"""Entries of one fog bundle, so that it stays below the longest payload with every state of each, in JSON too."""


@dataclass(frozen=True, kw_only=True)
class BundledState:
    """A state and, because no topic names it, its code."""

    state: Annotated[State, STATE]


@dataclass(frozen=True, kw_only=True)
class DroneBundle:
    """States that left a drone together, on `droneY/states`."""

    stamp: Stamp
    states: Annotated[tuple[BundledState, ...], Items(64)]


@dataclass(frozen=True, kw_only=True)
class RelayedStates:
    """States of one drone with one pair of stamps."""

    drone: DroneNumber
    relay_stamp: Stamp
    stamp: Stamp
    states: Annotated[tuple[BundledState, ...], Items(64)]


@dataclass(frozen=True, kw_only=True)
class FogBundle:
    """Changed states of a fog's drones, on `fogX/states`."""

    drones: Annotated[tuple[RelayedStates, ...], Items(MAX_DRONES)]


def drone_bundle(states: Iterable[State], stamp: int) -> DroneBundle:
    """The bundle of what is due together."""
    return DroneBundle(stamp=stamp, states=tuple(BundledState(state=state) for state in states))


def fog_bundles(relayed: Iterable[tuple[int, StampedState]]) -> list[FogBundle]:
    """The bundles of (drone, relayed state) pairs: one entry for each drone and pair of stamps, in their order."""
    grouped: dict[tuple[int, int, int], list[BundledState]] = {}
    for drone, message in relayed:
        assert message.relay_stamp is not None
        key = (drone, message.relay_stamp, message.stamp)
        grouped.setdefault(key, []).append(BundledState(state=message.state))
    entries = [
        RelayedStates(drone=drone, relay_stamp=relay_stamp, stamp=stamp, states=tuple(states))
        for (drone, relay_stamp, stamp), states in grouped.items()
    ]
    return [FogBundle(drones=tuple(entries[i : i + MAX_DRONES])) for i in range(0, len(entries), MAX_DRONES)]


def states_of(bundle: FogBundle) -> list[tuple[int, StampedState]]:
    """Each (drone, relayed state) of a fog's bundle."""
    return [
        (entry.drone, StampedState(bundled.state, entry.stamp, entry.relay_stamp))
        for entry in bundle.drones
        for bundled in entry.states
    ]
