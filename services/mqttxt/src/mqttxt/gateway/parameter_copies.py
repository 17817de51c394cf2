"""The gateway's copies of the drones' parameters, and how clients see them (docs/gateway.md)."""

from __future__ import annotations

import math
from collections import Counter
from functools import cached_property
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ..drone.mavlink.autopilot import Autopilot
from ..drone.mavlink.parameter_protocol import HASH_CHECK, carried
from ..errors import PayloadError
from ..protocol.parameters import Parameter, ParameterSet, ParameterType
from ..station.parameters import Parameters

TAKEOFF_ALTITUDE: Final = "MIS_TAKEOFF_ALT"
"""The parameter of the altitude, in metres above home, of a takeoff that names none. It is the gateway's own."""
TAKEOFF_M, LOWEST_M, HIGHEST_M = 10.0, 0.5, 10_000.0
FRESH_MS = 60_000
"""How long after it was read a set counts as the drone's."""
UNKNOWN = 2**16 - 1
"""In PARAM_VALUE, an unknown number of parameters, and a place outside of the list."""


class Shown:
    """Parameters in the order and with the places that clients see; all messages are PARAM_VALUE."""

    def __init__(self, parameters: ParameterSet, autopilot: Autopilot) -> None:
        self.autopilot = autopilot
        told = [(one, carried(one, autopilot.bytewise)) for one in parameters]
        self._told = [(one, value) for one, value in told if value is not None]
        self._places = {one.name: place for place, (one, _) in enumerate(self._told)}
        self._parameters = parameters

    def __len__(self) -> int:
        return len(self._told)

    def has_places_of(self, other: Shown) -> bool:
        """Whether each parameter has the same place in both."""
        return self is other or self._places == other._places

    def at(self, place: int) -> Any:
        """The parameter at a place from 0 on."""
        one, value = self._told[place]
        return value_message(one, value, len(self), place)

    def named(self, name: str) -> Any | None:
        """The parameter with a name; None if there is none."""
        place = self._places.get(name)
        return None if place is None else self.at(place)

    @cached_property
    def hash(self) -> Any | None:
        """PX4's own hash of these parameters; None for an autopilot without one, or if no float can carry it."""
        number = self.autopilot.hash_check(self._parameters)
        if number is None:
            return None
        one = Parameter(HASH_CHECK, ParameterType.UINT32, number)
        value = carried(one, bytewise=True)
        return None if value is None else value_message(one, value, len(self), UNKNOWN)


class ParameterCopies:
    """The parameter sets of all drones by their numbers, and the gateway's own parameter."""

    def __init__(self) -> None:
        self._sets: dict[int, Parameters] = {}
        self._read_ms: dict[int, int] = {}
        self._takeoff_m: dict[int, float] = {}
        self._shown: dict[int, Shown] = {}
        self._changes: Counter[int] = Counter()
        self._set_since: dict[int, dict[str, Parameter]] = {}

    def begin(self, drone: int) -> None:
        """Begin to read the drone's set: it may have older values of parameters that are set from now on."""
        self._set_since[drone] = {}

    def changes(self, drone: int) -> int:
        """A counter that rises whenever a drone's set may have changed."""
        return self._changes[drone]

    def last(self, drone: int) -> Parameters | None:
        """The set that was read last, however old it is."""
        return self._sets.get(drone)

    def is_fresh(self, drone: int, now_ms: int) -> bool:
        """Whether the set is recent enough to count as the drone's."""
        return now_ms - self._read_ms.get(drone, -FRESH_MS - 1) <= FRESH_MS

    def put(self, drone: int, parameters: Parameters, now_ms: int) -> None:
        """Store a set that was read, with the values that were set since reading began."""
        self._sets[drone], self._read_ms[drone] = parameters, now_ms
        self._shown.pop(drone, None)
        for wanted in self._set_since.pop(drone, {}).values():
            self._replace(drone, wanted)

    def fold(self, drone: int, wanted: Parameter) -> None:
        """Enter a value that was set and that the drone has read back, in the type that the copy has."""
        self._changes[drone] += 1
        if drone in self._set_since:
            self._set_since[drone][wanted.name] = wanted
        self._replace(drone, wanted)

    def _replace(self, drone: int, wanted: Parameter) -> None:
        known = self._sets.get(drone)
        before = known.content.parameters.get(wanted.name) if known is not None else None
        if known is None or before is None:
            return
        try:
            now = Parameter(wanted.name, before.type, wanted.value)
        except PayloadError:  # the copy is of another firmware
            self.forget(drone)
            return
        self._sets[drone] = Parameters(known.content.with_one(now))
        self._shown.pop(drone, None)

    def forget(self, drone: int) -> None:
        """The drone may have other values. The copy stays, so that only changes need to be transferred."""
        self._changes[drone] += 1
        self._read_ms.pop(drone, None)
        if drone in self._set_since:
            self.begin(drone)

    def takeoff_m(self, drone: int) -> float:
        """The altitude of a takeoff that names none, in metres above home."""
        return self._takeoff_m.get(drone, TAKEOFF_M)

    def set_takeoff(self, drone: int, altitude_m: float) -> bool:
        """Set that altitude; returns whether it is valid."""
        is_good = LOWEST_M <= altitude_m <= HIGHEST_M
        if is_good:
            self._takeoff_m[drone] = altitude_m
            self._shown.pop(drone, None)
        return is_good

    def shown(self, drone: int, autopilot: Autopilot) -> Shown:
        """The set that was read last, with the gateway's own parameter."""
        shown = self._shown.get(drone)
        if shown is None or shown.autopilot is not autopilot:
            known = self._sets.get(drone)
            content = known.content if known is not None else ParameterSet()
            shown = self._shown[drone] = Shown(ParameterSet.of([*content, self.own(drone)]), autopilot)
        return shown

    def own(self, drone: int) -> Parameter:
        """The gateway's own parameter."""
        return Parameter(TAKEOFF_ALTITUDE, ParameterType.REAL32, self.takeoff_m(drone))

    def own_alone(self, drone: int, autopilot: Autopilot) -> Shown:
        """A list of the gateway's own parameter alone, where no other is known."""
        return Shown(ParameterSet.of([self.own(drone)]), autopilot)

    def message(self, drone: int, autopilot: Autopilot, one: Parameter) -> Any:
        """PARAM_VALUE of a parameter's present value, in its place; before a set was read no place is known."""
        known = self.shown(drone, autopilot).named(one.name) if drone in self._sets else None
        if known is not None:
            return known
        value = carried(one, autopilot.bytewise)
        return value_message(one, math.nan if value is None else value, UNKNOWN, 0)  # MAVSDK needs a place


def value_message(one: Parameter, value: float, count: int, place: int) -> Any:
    """PARAM_VALUE."""
    return mavlink.MAVLink_param_value_message(one.name.encode(), value, int(one.type), count, place)
