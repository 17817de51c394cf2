"""Bundles: the states of one drone, or of a fog's drones, in one message (docs/protocol.md, section 10)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from .cbor import encode_plain
from .codec import encode, is_whole, layout_of, plain_of
from .fields import DroneNumber, Items, Stamp
from .state_payload import PlainState, StampedState
from .states import STATE, State
from .values import Encoding, Plain

MAX_DRONES = 50
"""The most entries of a fog bundle: with every state of each it stays below the longest payload, even in JSON."""


_MOST_STATES = 64
_STAMPS = range(2**16)
_ITEMS = {
    code: (frozenset({code}), *whole) for code, _, cls in STATE.codes if (whole := layout_of(cls).whole) is not None
}
"""The allowed integers of a bundled state's code and fields, for states whose fields are all integers."""


@dataclass(frozen=True, kw_only=True)
class BundledState:
    """A state and, because no topic names it, its code."""

    state: Annotated[State, STATE]


@dataclass(frozen=True, kw_only=True)
class DroneBundle:
    """States that left a drone together, on `droneY/states`."""

    stamp: Stamp
    states: Annotated[tuple[BundledState, ...], Items(_MOST_STATES)]


@dataclass(frozen=True, kw_only=True)
class RelayedStates:
    """States of one drone with one pair of stamps."""

    drone: DroneNumber
    relay_stamp: Stamp
    stamp: Stamp
    states: Annotated[tuple[BundledState, ...], Items(_MOST_STATES)]


@dataclass(frozen=True, kw_only=True)
class FogBundle:
    """Changed states of a fog's drones, on `fogX/states`."""

    drones: Annotated[tuple[RelayedStates, ...], Items(MAX_DRONES)]


def drone_bundle(states: Iterable[State], stamp: int) -> DroneBundle:
    """The bundle of states that are due together."""
    return DroneBundle(stamp=stamp, states=tuple(BundledState(state=state) for state in states))


def plain_states(payload: bytes) -> list[PlainState]:
    """The states in a drone's bundle. Raises PayloadError."""
    own_stamp, items = plain_of(DroneBundle, payload, _is_plainly_right)
    return [PlainState(STATE.by_code[item[0]].name, own_stamp, item) for item in items]


def _is_plainly_right(plain: Plain) -> bool:
    """Whether a drone's bundle has only allowed integers; False if in doubt."""
    if type(plain) is not list or len(plain) != 2 or type(plain[0]) is not int or plain[0] not in _STAMPS:
        return False
    items = plain[1]
    if type(items) is not list or len(items) > _MOST_STATES:
        return False
    for item in items:
        if type(item) is not list or not item or type(item[0]) is not int or not is_whole(_ITEMS.get(item[0]), item):
            return False
    return True


def fog_bundles(relayed: Iterable[tuple[int, StampedState]]) -> list[FogBundle]:
    """The bundles of (drone, relayed state) pairs: one entry for each drone and pair of stamps, in order."""
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


def encode_fog_bundles(relayed: Iterable[tuple[int, int, PlainState]], encoding: Encoding) -> list[bytes]:
    """The payloads of the bundles that `fog_bundles` would make of (drone, relay stamp, state) triples."""
    if encoding is Encoding.JSON:
        pairs = [(drone, StampedState(state.state, state.stamp, relay_stamp)) for drone, relay_stamp, state in relayed]
        return [encode(bundle, encoding) for bundle in fog_bundles(pairs)]
    grouped: dict[tuple[int, int, int], list[list[Plain]]] = {}
    for drone, relay_stamp, state in relayed:
        grouped.setdefault((drone, relay_stamp, state.stamp), []).append(state.item)
    entries = [[*key, items] for key, items in grouped.items()]
    return [encode_plain([entries[i : i + MAX_DRONES]]) for i in range(0, len(entries), MAX_DRONES)]


def states_of(bundle: FogBundle) -> list[tuple[int, StampedState]]:
    """Each (drone, relayed state) of a fog's bundle."""
    return [
        (entry.drone, StampedState(bundled.state, entry.stamp, entry.relay_stamp))
        for entry in bundle.drones
        for bundled in entry.states
    ]
