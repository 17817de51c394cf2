"""The states of a drone and their values (docs/protocol.md, section 3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, get_args

from .fields import U16, U32, Altitude, Hash, Integer, Latitude, Longitude, Named, Scaled, Text, Variant

Speed = Annotated[float, Scaled(100, 0, 655)]
"""Metres a second; CBOR carries centimetres a second."""
SpeedAlong = Annotated[float, Scaled(100, -327.68, 327.67)]
"""Metres a second along one axis."""
MavlinkEnum = Annotated[int, Integer(0, 255)]
"""A value of one of MAVLink's enumerations, as its number."""


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


class GpsFix(Named):
    """GPS_FIX_TYPE."""

    NO_GPS = 0
    NO_FIX = 1
    FIX_2D = 2
    FIX_3D = 3
    DGPS = 4
    RTK_FLOAT = 5
    RTK_FIXED = 6
    STATIC = 7
    PPP = 8


class Severity(Named):
    """MAV_SEVERITY."""

    EMERGENCY = 0
    ALERT = 1
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6
    DEBUG = 7


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


@dataclass(frozen=True)
class VelocityNed:
    """Speed over ground, north, east and down, in metres a second (GLOBAL_POSITION_INT.vx, vy, vz)."""

    name: ClassVar[str] = "velocity"
    north_m_s: SpeedAlong
    east_m_s: SpeedAlong
    down_m_s: SpeedAlong


@dataclass(frozen=True)
class Gps:
    """What the receiver has: the kind of its `fix`, its satellites, and hdop (GPS_RAW_INT)."""

    name: ClassVar[str] = "gps"
    fix: GpsFix
    satellites: Annotated[int, Integer(0, 254)] | None = None
    hdop: Annotated[float, Scaled(100, 0, 655.34)] | None = None


@dataclass(frozen=True)
class Power:
    """What the battery gives: `voltage_v` in volts, `current_a` in amperes (SYS_STATUS)."""

    name: ClassVar[str] = "power"
    voltage_v: Annotated[float, Scaled(1000, 0, 65.534)]
    current_a: Annotated[float, Scaled(100, 0, 327.67)] | None = None


@dataclass(frozen=True)
class Airframe:
    """What flies: its `autopilot` (MAV_AUTOPILOT), its `kind` (MAV_TYPE), and the firmware's `version`.

    HEARTBEAT has the first two, AUTOPILOT_VERSION.flight_sw_version the third.
    """

    name: ClassVar[str] = "airframe"
    autopilot: MavlinkEnum
    kind: MavlinkEnum
    version: U32 | None = None


@dataclass(frozen=True)
class AutopilotText:
    """What the autopilot says to people (STATUSTEXT): the whole `text`, and its `severity`."""

    name: ClassVar[str] = "text"
    severity: Severity
    text: Annotated[str, Text(200)]


@dataclass(frozen=True)
class Mission:
    """The drone's mission: its `current` item, the one `reached` last (0: none), and how many it has (`total`).

    Items count from 1 (MISSION_CURRENT, MISSION_ITEM_REACHED). `mission` names it (section 16); absent while unknown.
    """

    name: ClassVar[str] = "mission"
    current: U16
    reached: U16
    total: U16
    mission: Hash | None = None


@dataclass(frozen=True)
class Fence:
    """Whether the drone is outside its geofence (`breached`, FENCE_STATUS); `fence` names it, absent while unknown."""

    name: ClassVar[str] = "fence"
    breached: bool
    fence: Hash | None = None


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
    | VelocityNed
    | Gps
    | Power
    | Airframe
    | AutopilotText
    | Mission
    | Fence
)
"""The states that have names and forms of their own."""

State = VitalState | MavlinkState

STATES: dict[str, type[VitalState]] = {cls.name: cls for cls in get_args(VitalState)}
"""Every state by its name, but for MAVLink messages as they are."""


STATE = Variant(
    "state",
    tuple((code, cls.name, cls) for code, cls in enumerate(STATES.values(), start=1) if cls is not AutopilotText),
)
"""A state by its code (CBOR) or its name (JSON), where no topic names it: in bundles, which carry no text."""
CODES: dict[str, int] = {name: code for code, name, _ in STATE.codes}
"""The code of each state that bundles carry."""
