"""The states of a drone: their values, and when a change is worth publishing (docs/protocol.md, section 3)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from .commands import haversine_m
from .wire.fields import U32, Altitude, Integer, Latitude, Longitude, Named, Scaled, Variant

Speed = Annotated[float, Scaled(100, 0, 655)]
"""Metres a second; CBOR carries centimetres a second."""


class FlightModeName(Named):
    """PX4's flight modes by their common names; UNKNOWN for any other."""

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
    """Position: WGS84 degrees, metres above mean sea level, metres above home (GLOBAL_POSITION_INT)."""

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
    """On the ground, in the air, or between (EXTENDED_SYS_STATE.landed_state)."""

    name: ClassVar[str] = "landed_state"
    landed: Landed


@dataclass(frozen=True)
class MaxGroundspeed:
    """Largest horizontal speed in metres a second (parameter MPC_XY_VEL_MAX)."""

    name: ClassVar[str] = "max_groundspeed"
    max_groundspeed_m_s: Speed


@dataclass(frozen=True)
class Home:
    """The take-off point: WGS84 degrees, metres above mean sea level (HOME_POSITION)."""

    name: ClassVar[str] = "home"
    latitude_deg: Latitude
    longitude_deg: Longitude
    altitude_amsl_m: Altitude


@dataclass(frozen=True)
class Health:
    """Whether the autopilot would arm, and its sensors that are enabled but not healthy (SYS_STATUS bits)."""

    name: ClassVar[str] = "health"
    armable: bool
    unhealthy_sensors: U32


@dataclass(frozen=True)
class Endurance:
    """How long a full battery lasts in flight, configured or measured, and the cruise speed (MPC_XY_CRUISE)."""

    name: ClassVar[str] = "endurance"
    endurance_s: Annotated[int, Integer(60, 86_400)]
    cruise_m_s: Speed


FieldValue = int | float | str | None | tuple[int | float | None, ...]
"""What a field of a MAVLink message carries; None is a float that is no number."""


@dataclass(frozen=True)
class MavlinkState:
    """A MAVLink message as it is, on request (`stream`): its fields by their names in common.xml.

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


@dataclass(frozen=True)
class Policy:
    """When a state is published: beyond its deadband, at most at its rate, at least once a heartbeat interval.

    `exceeds(old, new)` tells whether the change is larger than the deadband; `deadband` says it in words.
    """

    exceeds: Callable[[Any, Any], bool]
    min_interval_ms: int
    heartbeat_ms: int = 30_000
    deadband: str = "any change"


def _changed(old: State, new: State) -> bool:
    return old != new


def _moved(old: Location, new: Location) -> bool:
    across = haversine_m(old.latitude_deg, old.longitude_deg, new.latitude_deg, new.longitude_deg)
    return across > 0.5 or abs(old.altitude_amsl_m - new.altitude_amsl_m) > 0.5


def _turned(old: Heading, new: Heading) -> bool:
    turn = abs(old.heading_deg - new.heading_deg) % 360
    return min(turn, 360 - turn) > 5


def _sped(old: Groundspeed, new: Groundspeed) -> bool:
    return abs(old.groundspeed_m_s - new.groundspeed_m_s) > 0.5


POLICIES: dict[str, Policy] = {
    "battery": Policy(_changed, min_interval_ms=1000),
    "location": Policy(_moved, min_interval_ms=1000, deadband="0.5 m"),
    "heading": Policy(_turned, min_interval_ms=1000, deadband="5°"),
    "groundspeed": Policy(_sped, min_interval_ms=1000, deadband="0.5 m/s"),
    "flight_mode": Policy(_changed, min_interval_ms=100),
    "armed": Policy(_changed, min_interval_ms=100),
    "landed_state": Policy(_changed, min_interval_ms=100),
    "max_groundspeed": Policy(_changed, min_interval_ms=1000),
    "home": Policy(_changed, min_interval_ms=1000),
    "health": Policy(_changed, min_interval_ms=1000),
    "endurance": Policy(_changed, min_interval_ms=1000),
}
"""The defaults: battery 1 %, location 0.5 m, heading 5 degrees, groundspeed 0.5 m/s, the others any change."""

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
        return now_ms - at_ms >= policy.min_interval_ms and policy.exceeds(last, state)
