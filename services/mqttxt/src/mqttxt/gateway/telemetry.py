"""MAVLink messages made from the states that the station has, at a ground station's rates; none crosses a link."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar, cast

from pymavlink.dialects.v20 import common as mavlink

from ..drone.mavlink.vehicle import UNKNOWN_U8, UNKNOWN_U16
from ..protocol.states import (
    Airframe,
    Armed,
    Battery,
    FlightMode,
    Gps,
    GpsFix,
    Groundspeed,
    Heading,
    Health,
    Home,
    Landed,
    LandedState,
    Location,
    Mission,
    Power,
    State,
    VelocityNed,
    VitalState,
)
from ..station.views import KnownState
from .modes import ARDUPILOT, base_mode, custom_mode

NAN = math.nan
_INT16_UNKNOWN = 2**15 - 1
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
)
"""Every autopilot with a position has these; `health` names those that fail.

MAVProxy takes an unhealthy geofence, present or not, for a breach.
"""
_BATTERY_CELLS, _BATTERY_CELLS_EXT = 10, 4

UNKNOWN_AUTOPILOT = "the kind of the drone's autopilot is not known yet"
RECENT_MS = 6000
"""How old the newest of several states may be for all of them to hold: a drone publishes `velocity` every 3 s at least,
and its other states when they change."""

AState = TypeVar("AState", bound=VitalState)


@dataclass(frozen=True)
class View:
    """What the station knows of a drone now; `now_ms` is of the gateway's clock.

    `named`: the hash of the mission that the client in question uploaded or read last; None before the first.
    """

    number: int
    states: Mapping[str, KnownState[State]]
    now_ms: int
    named: bytes | None = None

    def get(self, kind: type[AState]) -> AState | None:
        """The newest state of a kind."""
        known = self.states.get(kind.name)
        return None if known is None else cast("AState", known.state)

    def is_recent(self, *kinds: type[VitalState], within_ms: int = RECENT_MS) -> bool:
        """Whether a state of one of these kinds is at most `within_ms` old."""
        ages_ms = (known.age_ms for kind in kinds if (known := self.states.get(kind.name)) is not None)
        return any(age_ms is not None and age_ms <= within_ms for age_ms in ages_ms)

    @property
    def home_items(self) -> int:
        """How many items a client's list has before the mission's own: with ArduPilot home is item 0."""
        airframe = self.get(Airframe)
        return int(airframe is not None and airframe.autopilot == ARDUPILOT)

    def seq(self, item: int) -> int:
        """The client's number of an item of the plan, which counts from 1; 0, which is no item, gives the first."""
        return max(0, item - 1 + self.home_items)

    def item(self, seq: int) -> int:
        """The plan's number of an item by the client's; ArduPilot's home gives the plan's first."""
        return max(1, seq + 1 - self.home_items)

    def measured_ms(self, kind: type[VitalState]) -> int:
        """The earliest time at which the newest state of a kind was measured: MAVLink's time since boot."""
        known = self.states.get(kind.name)
        age_ms = known.age_ms if known is not None else None
        return max(0, self.now_ms - (age_ms or 0))


@dataclass(frozen=True)
class Made:
    """How a message is made (None while a state that it needs is missing), and how often it is sent unasked."""

    make: Callable[[View], Any | None]
    rate_hz: float


def _heartbeat(view: View) -> Any | None:
    airframe, armed, mode = view.get(Airframe), view.get(Armed), view.get(FlightMode)
    if airframe is None or armed is None or mode is None:
        return None
    return mavlink.MAVLink_heartbeat_message(
        airframe.kind,
        airframe.autopilot,
        base_mode(airframe.autopilot, mode.mode, armed.armed),
        custom_mode(airframe.autopilot, mode.mode) or 0,
        mavlink.MAV_STATE_ACTIVE if armed.armed else mavlink.MAV_STATE_STANDBY,
        3,
    )


def _sys_status(view: View) -> Any:
    health = view.get(Health)
    present = healthy = 0
    if health is not None:
        prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        present = _SENSORS | prearm | health.unhealthy_sensors
        sound = (_SENSORS | mavlink.MAV_SYS_STATUS_GEOFENCE) & ~health.unhealthy_sensors
        healthy = sound | (prearm if health.armable else 0)
    voltage_mv, current_ca = _power(view)
    return mavlink.MAVLink_sys_status_message(
        present, present, healthy, 0, voltage_mv, current_ca, _remaining(view), 0, 0, 0, 0, 0, 0
    )


def _battery_status(view: View) -> Any | None:
    voltage_mv, current_ca = _power(view)
    if voltage_mv == UNKNOWN_U16 and _remaining(view) < 0:
        return None
    cells = [voltage_mv, *[UNKNOWN_U16] * (_BATTERY_CELLS - 1)]
    return mavlink.MAVLink_battery_status_message(
        0, 0, 0, _INT16_UNKNOWN, cells, current_ca, -1, -1, _remaining(view), 0, 0, [0] * _BATTERY_CELLS_EXT
    )


def _position(view: View) -> Any | None:
    """MAVLink cannot express an unknown velocity: without one there is no message."""
    location, velocity, heading = view.get(Location), view.get(VelocityNed), view.get(Heading)
    if location is None or velocity is None:
        return None
    latitude, longitude = _degrees(location)
    return mavlink.MAVLink_global_position_int_message(
        time_boot_ms=view.measured_ms(Location) % 2**32,
        lat=latitude,
        lon=longitude,
        alt=round(location.altitude_amsl_m * 1000),
        relative_alt=round(location.altitude_m * 1000),
        vx=round(velocity.north_m_s * 100),
        vy=round(velocity.east_m_s * 100),
        vz=round(velocity.down_m_s * 100),
        hdg=UNKNOWN_U16 if heading is None else round(heading.heading_deg * 100),
    )


def _vfr_hud(view: View) -> Any | None:
    location, velocity = view.get(Location), view.get(VelocityNed)
    heading, speed = view.get(Heading), view.get(Groundspeed)
    if location is None or heading is None or speed is None:
        return None
    return mavlink.MAVLink_vfr_hud_message(
        NAN,
        speed.groundspeed_m_s,
        round(heading.heading_deg) % 360,
        UNKNOWN_U16,
        location.altitude_amsl_m,
        NAN if velocity is None else -velocity.down_m_s,
    )


def _extended(view: View) -> Any:
    landed = view.get(LandedState)
    state = Landed.UNDEFINED if landed is None else landed.landed
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, state)


def _home(view: View) -> Any | None:
    home = view.get(Home)
    if home is None:
        return None
    latitude, longitude = _degrees(home)
    return mavlink.MAVLink_home_position_message(
        latitude=latitude,
        longitude=longitude,
        altitude=round(home.altitude_amsl_m * 1000),
        x=NAN,
        y=NAN,
        z=NAN,
        q=[NAN] * 4,
        approach_x=NAN,
        approach_y=NAN,
        approach_z=NAN,
    )


def _gps(view: View) -> Any | None:
    gps, location = view.get(Gps), view.get(Location)
    if gps is None or (location is None and gps.fix > GpsFix.NO_FIX):
        return None
    latitude, longitude = (0, 0) if location is None else _degrees(location)
    return mavlink.MAVLink_gps_raw_int_message(
        time_usec=view.measured_ms(Gps) * 1000,
        fix_type=gps.fix,
        lat=latitude,
        lon=longitude,
        alt=0 if location is None else round(location.altitude_amsl_m * 1000),
        eph=UNKNOWN_U16 if gps.hdop is None else round(gps.hdop * 100),
        epv=UNKNOWN_U16,
        vel=UNKNOWN_U16,
        cog=UNKNOWN_U16,
        satellites_visible=UNKNOWN_U8 if gps.satellites is None else gps.satellites,
    )


def _mission_current(view: View) -> Any | None:
    mission = view.get(Mission)
    if mission is None:
        return None
    return mavlink.MAVLink_mission_current_message(view.seq(mission.current), mission.total or UNKNOWN_U16)


def _version(view: View) -> Any | None:
    airframe = view.get(Airframe)
    if airframe is None:
        return None
    none = [0] * 8
    encoding = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        if airframe.autopilot == ARDUPILOT
        else mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    )
    return mavlink.MAVLink_autopilot_version_message(
        CAPABILITIES | encoding, airframe.version or 0, 0, 0, 0, none, none, none, 0, 0, 0
    )


def _degrees(place: Location | Home) -> tuple[int, int]:
    return round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)


def _power(view: View) -> tuple[int, int]:
    """Voltage in millivolts and current in centiamperes; MAVLink's value for unknown in place of a missing one."""
    power = view.get(Power)
    if power is None:
        return UNKNOWN_U16, -1
    return round(power.voltage_v * 1000), -1 if power.current_a is None else round(power.current_a * 100)


def _remaining(view: View) -> int:
    battery = view.get(Battery)
    return -1 if battery is None else battery.remaining_pct


LOCAL: Final[dict[str, Made]] = {
    "HEARTBEAT": Made(_heartbeat, 1),
    "SYS_STATUS": Made(_sys_status, 1),
    "EXTENDED_SYS_STATE": Made(_extended, 1),
    "GLOBAL_POSITION_INT": Made(_position, 4),
    "VFR_HUD": Made(_vfr_hud, 4),
    "GPS_RAW_INT": Made(_gps, 1),
    "BATTERY_STATUS": Made(_battery_status, 0.5),
    "HOME_POSITION": Made(_home, 0.5),
    "MISSION_CURRENT": Made(_mission_current, 1),
    "AUTOPILOT_VERSION": Made(_version, 0),
}
"""The messages that are made here. The rates are those of PX4's normal stream set, or at which states change."""
FASTEST_HZ = 10.0


class Turns:
    """When each message of each drone is sent next.

    Messages of one rate are sent in the same turn. Clients that command the vehicle whose HEARTBEAT arrived first, as
    pymavlink and MAVProxy do, thus get the same vehicle whenever they connect.
    """

    def __init__(self) -> None:
        self._next_ms: dict[tuple[int, str], float] = {}
        self._rates_hz: dict[tuple[int, str], float] = {}

    def ask(self, drone: int, name: str, rate_hz: float) -> None:
        """A client asks for a message more often. No client's rate is lowered; the limit is how fast states change."""
        known_hz = self._rates_hz.get((drone, name), LOCAL[name].rate_hz)
        self._rates_hz[drone, name] = max(known_hz, min(rate_hz, FASTEST_HZ))

    def due(self, drone: int, now_ms: int) -> list[str]:
        """The messages that are due."""
        out = []
        for name, made in LOCAL.items():
            rate_hz = self._rates_hz.get((drone, name), made.rate_hz)
            next_ms = self._next_ms.get((drone, name), 0.0)
            if rate_hz and now_ms >= next_ms:
                interval_ms = 1000 / rate_hz
                self._next_ms[drone, name] = now_ms - now_ms % interval_ms + interval_ms
                out.append(name)
        return out

    def hasten(self, drone: int, name: str) -> None:
        """Make a message due at once, because its content has changed."""
        self._next_ms.pop((drone, name), None)
