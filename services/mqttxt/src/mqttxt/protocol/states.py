"""The states of a drone and their values (docs/protocol.md, section 3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Annotated, ClassVar, get_type_hints

from ..errors import PayloadError
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
