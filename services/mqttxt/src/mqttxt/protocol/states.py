"""The states of a drone: their values, and when a change is worth publishing (docs/protocol.md, section 3)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Annotated, Any, ClassVar, get_type_hints

from ..errors import PayloadError
from .commands import haversine_m
from .fields import U32, Altitude, Integer, Latitude, Longitude, Named, Scaled, Variant
from .values import mark_of

Speed = Annotated[float, Scaled(100, 0, 655)]
"""Metres a second; CBOR carries centimetres a second."""


class FlightModeName(Named):
    """The flight modes of PX4 and of ArduPilot's multicopters; UNKNOWN for any other.

    GUIDED and what follows it are ArduPilot's alone. Its STABILIZE, ALT_HOLD, AUTO and RTL are STABILIZED, ALTITUDE,
    MISSION and RETURN.
    """

    UNKNOWN = 0
    MANUAL = 1
    ALTITUDE = 2
    POSITION = 3
    ACRO = 4
    STABILIZED = 5
    OFFBOARD = 6
    HOLD = 7
    MISSION = 8
    TAKEOFF = 9
    RETURN = 10
    LAND = 11
    FOLLOW = 12
    PRECISION_LAND = 13
    ORBIT = 14
    GUIDED = 15
    LOITER = 16
    BRAKE = 17
    CIRCLE = 18
    DRIFT = 19
    SPORT = 20
    FLIP = 21
    AUTOTUNE = 22
    POSHOLD = 23
    THROW = 24
    AVOID_ADSB = 25
    GUIDED_NOGPS = 26
    SMART_RTL = 27
    FLOWHOLD = 28
    ZIGZAG = 29
    SYSTEMID = 30
    AUTOROTATE = 31
    AUTO_RTL = 32
    TURTLE = 33


class Landed(Named):
    """MAV_LANDED_STATE."""

    UNDEFINED = 0
    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


@dataclass(frozen=True)
class Battery:
    """Remaining charge; percent, as BATTERY_STATUS.battery_remaining."""

    name: ClassVar[str] = "battery"
    remaining_pct: Annotated[int, Integer(0, 100)]


@dataclass(frozen=True)
class Location:
    """Position: WGS84 degrees, metres above mean sea level, metres above home (GLOBAL_POSITION_INT and R3.10)."""

    name: ClassVar[str] = "location"
    latitude_deg: Latitude
    longitude_deg: Longitude
    altitude_amsl_m: Altitude
    altitude_m: Altitude


@dataclass(frozen=True)
class Heading:
    """Degrees clockwise from north (GLOBAL_POSITION_INT.hdg)."""

    name: ClassVar[str] = "heading"
    heading_deg: Annotated[float, Scaled(100, 0, 359.99)]


@dataclass(frozen=True)
class Groundspeed:
    """Horizontal speed over ground in metres a second (VFR_HUD.groundspeed)."""

    name: ClassVar[str] = "groundspeed"
    groundspeed_m_s: Speed


@dataclass(frozen=True)
class FlightMode:
    """The autopilot's mode (HEARTBEAT.custom_mode)."""

    name: ClassVar[str] = "flight_mode"
    mode: FlightModeName


@dataclass(frozen=True)
class Armed:
    """Whether the motors are armed (HEARTBEAT.base_mode)."""

    name: ClassVar[str] = "armed"
    armed: bool


@dataclass(frozen=True)
class LandedState:
    """Whether it has `landed`, is in the air, or between (EXTENDED_SYS_STATE.landed_state)."""

    name: ClassVar[str] = "landed_state"
    landed: Landed


@dataclass(frozen=True)
class MaxGroundspeed:
    """Largest horizontal speed in metres a second (parameter MPC_XY_VEL_MAX; ArduPilot: WPNAV_SPEED or WP_SPD)."""

    name: ClassVar[str] = "max_groundspeed"
    max_groundspeed_m_s: Speed


@dataclass(frozen=True)
class Home:
    """The take-off point: WGS84 degrees, metres above mean sea level (HOME_POSITION and R3.10)."""

    name: ClassVar[str] = "home"
    latitude_deg: Latitude
    longitude_deg: Longitude
    altitude_amsl_m: Altitude


@dataclass(frozen=True)
class Health:
    """Whether the autopilot would arm (`armable`), and its `unhealthy_sensors` among the enabled (SYS_STATUS bits)."""

    name: ClassVar[str] = "health"
    armable: bool
    unhealthy_sensors: U32


@dataclass(frozen=True)
class Endurance:
    """How long a full battery lasts in flight, configured or measured, and the cruise speed.

    The cruise speed is MPC_XY_CRUISE; with ArduPilot WPNAV_SPEED or WP_SPD.
    """

    name: ClassVar[str] = "endurance"
    endurance_s: Annotated[int, Integer(60, 86_400)]
    cruise_m_s: Speed


FieldValue = int | float | str | None | tuple[int | float | None, ...]
"""What a field of a MAVLink message carries; None is a float that is no number."""


@dataclass(frozen=True)
class MavlinkState:
    """A MAVLink message as it is, on request (`stream`): `values` are its fields by their names in common.xml.

    `name` is `mavlink/` and the message's name.
    """

    name: str
    values: Mapping[str, FieldValue]


VitalState = (
    Battery
    | Location
    | Heading
    | Groundspeed
    | FlightMode
    | Armed
    | LandedState
    | MaxGroundspeed
    | Home
    | Health
    | Endurance
)
"""The states that have names and forms of their own."""

State = VitalState | MavlinkState

STATES: dict[str, type[VitalState]] = {
    cls.name: cls
    for cls in (
        Battery,
        Location,
        Heading,
        Groundspeed,
        FlightMode,
        Armed,
        LandedState,
        MaxGroundspeed,
        Home,
        Health,
        Endurance,
    )
}
"""Every state by its name, but for MAVLink messages as they are."""


STATE = Variant("state", tuple((code, cls.name, cls) for code, cls in enumerate(STATES.values(), start=1)))
"""A state by its code (CBOR) or its name (JSON), where no topic names it."""


@cache
def _ranges(name: str) -> tuple[tuple[str, Integer | Scaled], ...]:
    cls = STATES[name]
    hints = get_type_hints(cls, include_extras=True)
    marks = ((item.name, mark_of(hints[item.name])) for item in fields(cls))
    return tuple((field, mark) for field, mark in marks if isinstance(mark, Integer | Scaled))


def check_range(state: State) -> None:
    """Raises PayloadError where a number of a state is outside the range that the state has."""
    if isinstance(state, MavlinkState):
        return
    for field, mark in _ranges(state.name):
        value = getattr(state, field)
        if not mark.low <= value <= mark.high:
            raise PayloadError(f"{state.name}.{field}: expected {mark.low:g} to {mark.high:g}, got {value!r}")


def _any_change(old: State, new: State) -> bool:
    return old != new


@dataclass(frozen=True)
class Policy:
    """When a state is published: beyond its deadband, at most at its rate, at least once a heartbeat interval.

    `exceeds(old, new)` tells whether the change is larger than the deadband; `deadband` says it in words. Where it
    `is_for_rest`, that holds for a drone that is disarmed, and an armed one publishes any change.
    """

    exceeds: Callable[[Any, Any], bool]
    min_interval_ms: int
    heartbeat_ms: int = 30_000
    deadband: str = "any change"
    is_for_rest: bool = False


def _beyond(
    limit: float, unit: str, change: Callable[[Any, Any], float], words: str = "", rest: bool = False
) -> Policy:
    """Once a change is larger than `limit`; `words` go with it in the specification's table."""
    said = f"{limit:g}{unit}{words}"
    return Policy(lambda old, new: change(old, new) > limit, 1000, deadband=said, is_for_rest=rest)


def _across_m(old: Location | Home, new: Location | Home) -> float:
    return haversine_m(old.latitude_deg, old.longitude_deg, new.latitude_deg, new.longitude_deg)


def _up_m(old: Location | Home, new: Location | Home) -> float:
    return abs(old.altitude_amsl_m - new.altitude_amsl_m)


def _moved_m(old: Location, new: Location) -> float:
    return max(_across_m(old, new), _up_m(old, new), abs(old.altitude_m - new.altitude_m))


def _home_moved_m(old: Home, new: Home) -> float:
    return max(_across_m(old, new), _up_m(old, new))


def _gained_pct(old: Battery, new: Battery) -> float:
    """A battery under load is told a percent lower and higher by turns: each figure is told once while it drains."""
    gained = new.remaining_pct - old.remaining_pct
    return math.inf if gained < 0 else gained


def _turned_deg(old: Heading, new: Heading) -> float:
    turn = abs(old.heading_deg - new.heading_deg) % 360
    return min(turn, 360 - turn)


def _sped_m_s(old: Groundspeed, new: Groundspeed) -> float:
    return abs(old.groundspeed_m_s - new.groundspeed_m_s)


_URGENTLY = Policy(_any_change, min_interval_ms=100)
_AT_ONCE = Policy(_any_change, min_interval_ms=1000)
HOME_M = 1.0
"""Home that is further from where it was is another place: PX4 moves it by up to 0.7 m across and 1.2 m up, every two
seconds, while its position settles."""

POLICIES: dict[str, Policy] = {
    "battery": _beyond(1, " %", _gained_pct, " more, any less"),
    "location": _beyond(0.5, " m", _moved_m),
    "heading": _beyond(5, "°", _turned_deg),
    "groundspeed": _beyond(0.5, " m/s", _sped_m_s),
    "flight_mode": _URGENTLY,
    "armed": _URGENTLY,
    "landed_state": _URGENTLY,
    "max_groundspeed": _AT_ONCE,
    "home": _beyond(HOME_M, " m, any change while armed", _home_moved_m, rest=True),
    "health": _AT_ONCE,
    "endurance": _AT_ONCE,
}
"""The defaults."""


def is_elsewhere(old: Home, new: Home) -> bool:
    """Whether home was put to another place, and not only corrected in its altitude."""
    return _across_m(old, new) > HOME_M


URGENT = frozenset({"armed", "flight_mode", "landed_state"})
"""What a bundle does not wait with."""


class Throttle:
    """Decides when each state of one drone is published, by its policy; `apart` are those that others publish."""

    def __init__(self, policies: dict[str, Policy] | None = None) -> None:
        self.apart: frozenset[str] = frozenset()
        self._policies = {**POLICIES, **(policies or {})}
        self._current: dict[str, State] = {}
        self._published: dict[str, tuple[State, int]] = {}

    def update(self, state: State) -> None:
        """Take in the newest value of a state."""
        self._current[state.name] = state

    def due(self, now_ms: int) -> list[State]:
        """The states to publish now, in the order of their first appearance; they count as published."""
        found = [state for state in self._current.values() if self._is_due(state, now_ms)]
        for state in found:
            self._published[state.name] = (state, now_ms)
        return found

    def current(self, name: str) -> State | None:
        """The newest value of a state."""
        return self._current.get(name)

    def is_due(self, names: Iterable[str], now_ms: int) -> bool:
        """Whether any of some states would be published now."""
        return any(name in self._current and self._is_due(self._current[name], now_ms) for name in names)

    def forget_published(self) -> None:
        """Publish everything anew at the next `due`: the other side lost what it knew."""
        self._published.clear()

    def _is_due(self, state: State, now_ms: int) -> bool:
        if state.name in self.apart:
            return False
        if state.name not in self._published:
            return True
        policy = self._policies[state.name]
        last, at_ms = self._published[state.name]
        if now_ms - at_ms >= policy.heartbeat_ms:
            return True
        exceeds = _any_change if policy.is_for_rest and self.current(Armed.name) == Armed(True) else policy.exceeds
        return now_ms - at_ms >= policy.min_interval_ms and exceeds(last, state)
