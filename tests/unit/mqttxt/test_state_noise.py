"""How often a real autopilot's states are published, at rest and in flight, and that its heights do not jump.

The recordings are PX4's with its own simulator, by `tests/bench/autopilot_log.py`: its release 1.15, whose home moves
until it is armed, and its main of 2026, which corrects home's altitude in flight.
"""

from __future__ import annotations

import json
from collections import Counter
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from mqttxt.drone.mavlink.vehicle import SOURCES, Vehicle
from mqttxt.protocol.mavlink_states import kinds
from mqttxt.protocol.policies import ON_REQUEST, Throttle
from mqttxt.protocol.states import Armed, Location, State
from tests.simulation.world import from_autopilot

RECORDINGS = ("px4-1.15", "px4-main")
TICK_MS = 100
AT_REST = {"home": 6, "location": 7, "groundspeed": 8, "health": 6}
IN_FLIGHT = {"home": 4, "location": 50, "heading": 8, "groundspeed": 13, "battery": 13}
"""Messages a minute that are not exceeded; of the others MOST. A state that does not change has two."""
MOST = 4
JUMP_M = 0.3

Told = list[tuple[int, list[State]]]


@cache
def recorded(name: str) -> Told:
    """What each message told, and when in milliseconds; the vehicle is the project's own."""
    recording = json.loads((Path(__file__).parent / "recordings" / f"{name}.json").read_text())
    vehicle = Vehicle(1)
    return [
        (at_ms, vehicle.update(_message(kind, recording["fields"][kind], values), at_ms))
        for at_ms, kind, *values in recording["rows"]
    ]


def _message(kind: str, names: list[str], values: list[Any]) -> Any:
    cls = kinds()[kind]
    fields = {
        name: [0] * length if length else 0
        for name, length in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True)
    }
    return from_autopilot(cls(**{**fields, **dict(zip(names, values, strict=True))}))


@cache
def published(name: str) -> list[tuple[int, State, bool]]:
    """What a UAV client would publish, ten times a second; whether the drone was armed then."""
    throttle, out, now_ms = Throttle(), [], 0
    throttle.apart = ON_REQUEST
    for at_ms, told in recorded(name):
        while now_ms < at_ms:
            armed = throttle.current("armed") == Armed(True)
            out += [(now_ms, state, armed) for state in throttle.due(now_ms)]
            now_ms += TICK_MS
        for state in told:
            throttle.update(state)
    return out


def minutes(name: str, armed: bool) -> float:
    """How long the drone of a recording was armed, or was not before."""
    times = [at_ms for at_ms, told in recorded(name) if Armed(True) in told]
    return ((times[-1] - times[0]) if armed else times[0]) / 60_000


@pytest.mark.parametrize("armed", [False, True], ids=["at rest", "in flight"])
@pytest.mark.parametrize("name", RECORDINGS)
def test_no_state_is_published_more_often_than_a_user_needs_it(name: str, armed: bool) -> None:
    first_ms = next(at_ms for at_ms, state, _ in published(name) if state == Armed(True))
    counts = Counter(state.name for at_ms, state, was in published(name) if (was if armed else at_ms < first_ms))
    rates = {state: count / minutes(name, armed) for state, count in counts.items()}
    most = IN_FLIGHT if armed else AT_REST
    assert {state: rate for state, rate in rates.items() if rate > most.get(state, MOST)} == {}, rates
    assert set(rates) == set(SOURCES) - ON_REQUEST - {"mission", "fence"}  # whose messages are not in the recordings


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_height_changes_only_as_the_drone_climbs(name: str) -> None:
    flown, armed = [], False
    for _, told in recorded(name):
        for state in told:
            armed = state == Armed(True) if isinstance(state, Armed) else armed
            if armed and isinstance(state, Location):
                flown.append(state)
    steps = [
        abs((after.altitude_m - before.altitude_m) - (after.altitude_amsl_m - before.altitude_amsl_m))
        for before, after in pairwise(flown)
    ]
    assert len(steps) > 150
    assert max(steps) < JUMP_M
    assert max(state.altitude_m for state in flown) > 9.5


def test_the_recording_of_main_has_a_home_that_is_corrected_in_flight() -> None:
    recording = json.loads((Path(__file__).parent / "recordings" / "px4-main.json").read_text())
    places = [row for row in recording["rows"] if row[1] == "GLOBAL_POSITION_INT"]
    homes_m = [(alt - relative) / 1000 for _, _, _, _, alt, relative, _ in places]
    assert sum(abs(after - before) > JUMP_M for before, after in pairwise(homes_m)) > 10
