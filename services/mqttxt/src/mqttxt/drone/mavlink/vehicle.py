"""The autopilot's newest states: MAVLink messages in, MQTT-XT's states out."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.state_fields import check_range
from ...protocol.states import (
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
    MaxGroundspeed,
    Power,
    State,
    VelocityNed,
    VitalState,
)
from .arrivals import Arrivals
from .autopilot import Autopilot
from .autopilots import kind_of
from .boots import Boots
from .home import HomeOfArming
from .lost_fix import LostFix
from .mission_progress import MissionProgress
from .plans import AUTOPILOT_COMPONENT, CannotExecute
from .statustext import StatusTexts

HEARTBEAT_LOST_MS = 3000
LOST_MS = 10_000
"""After this time without a heartbeat, ten in a row, the state of an autopilot's commands is unknown."""
UNKNOWN_U8, UNKNOWN_U16 = 2**8 - 1, 2**16 - 1
"""MAVLink's values for an unknown quantity."""
STILL_M_S, STILL_CLIMB_M_S, STILL_MS = 1.0, 0.5, 1000
"""A drone stands still if it is slower than both for this long: one that turns back is slow for less."""

Value = TypeVar("Value", bound=VitalState)


@dataclass(frozen=True)
class Seen(Generic[Value]):
    """A state, and the number and time of its message; a higher number was received later."""

    state: Value
    number: int
    at_ms: int


class Vehicle:
    """One autopilot as seen through its MAVLink messages.

    `number` counts the messages taken in, so that "newer than the acknowledgement" needs no clock.
    """

    def __init__(self, system_id: int) -> None:
        self.system_id = system_id
        self.number = 0
        self.heartbeat_ms: int | None = None
        self.heard_ms: int | None = None
        self.boots = Boots()
        self.arrivals = Arrivals()
        self.states: dict[str, Seen[Any]] = {}
        self.cruise_m_s: float | None = None
        self.mission = MissionProgress()
        self._autopilot: Autopilot | None = None
        self._still: list[tuple[int, int]] = []
        self._texts = StatusTexts()
        self._text = (-1, "")
        self._home = HomeOfArming()
        self._lost_fix = LostFix()
        self._readers_of_kind = {
            **dict.fromkeys(("MISSION_CURRENT", "MISSION_ITEM_REACHED", "FENCE_STATUS"), self.mission.on_message),
            "HEARTBEAT": self._read_heartbeat,
            "SYS_STATUS": self._read_status,
            "AUTOPILOT_VERSION": self._read_version,
            "PARAM_VALUE": self._read_parameter,
        }
        """Readers that depend on the kind of autopilot: used once it is known."""

    @property
    def autopilot(self) -> Autopilot:
        """The kind of autopilot. Raises CannotExecute before its first heartbeat."""
        if self._autopilot is None:
            raise CannotExecute("no_autopilot")
        return self._autopilot

    def is_alive(self, now_ms: int) -> bool:
        """Whether a heartbeat arrived within the last three seconds."""
        return self.heartbeat_ms is not None and now_ms - self.heartbeat_ms <= HEARTBEAT_LOST_MS

    def is_heard(self, now_ms: int) -> bool:
        """Whether any message of the autopilot arrived within the last three seconds, and a heartbeat ever."""
        return self.heartbeat_ms is not None and now_ms - (self.heard_ms or 0) <= HEARTBEAT_LOST_MS

    def is_lost(self, now_ms: int) -> bool:
        """Whether the last heartbeat that surely precedes any restart is more than ten seconds old."""
        sure_ms = self.heartbeat_ms if self.boots.is_sure else self.boots.sure_ms
        return sure_ms is None or now_ms - sure_ms > LOST_MS

    def answers_twice(self, mav_cmd: int) -> bool:
        """Whether the autopilot may acknowledge a MAV_CMD a second time after it has accepted it."""
        return self._autopilot is not None and mav_cmd in self._autopilot.answers_twice

    def seen(self, cls: type[Value], after: int = -1) -> Value | None:
        """The last state of a class, if its message arrived after message number `after`."""
        found = self.states.get(cls.name)
        return found.state if found is not None and found.number > after else None

    def age_ms(self, name: str, now_ms: int) -> float:
        """The time since the newest value of a state, ms; infinite without one. Its messages may come without one."""
        found = self.states.get(name)
        return math.inf if found is None else now_ms - found.at_ms

    def is_still(self, after: int) -> bool:
        """Whether the drone has been standing still for a second, by messages after message number `after`."""
        shown = [at_ms for number, at_ms in self._still if number > after]
        return bool(shown) and shown[-1] - shown[0] >= STILL_MS

    def is_own(self, message: Any) -> bool:
        """Whether a message is from this autopilot."""
        return bool(message.get_srcSystem() == self.system_id and message.get_srcComponent() == AUTOPILOT_COMPONENT)

    def text_since(self, number: int) -> str:
        """The last text of at least warning severity that ended after message number `number`, empty without one."""
        return self._text[1] if self._text[0] > number else ""

    def update(self, message: Any, now_ms: int) -> list[State]:
        """Take in a message of this autopilot; returns the states in it.

        Raises PayloadError, and takes none of its states, if a value is outside its state's range.
        """
        if not self.is_own(message):
            return []
        kind = message.get_type()
        if kind == "HEARTBEAT" and not self._is_of_kind(message):
            return []
        self.number += 1
        self.boots.on_message(message, 0 if self.heard_ms is None else now_ms - self.heard_ms, self.heartbeat_ms)
        self.heard_ms = now_ms
        self.arrivals.note(kind, self.number, now_ms)
        if kind == "HEARTBEAT":
            self.heartbeat_ms = now_ms
        elif kind == "STATUSTEXT":
            for severity, text in self._texts.take(message):
                if severity <= mavlink.MAV_SEVERITY_WARNING:
                    self._text = (self.number, text)
        reader = _READERS.get(kind) or (self._readers_of_kind.get(kind) if self._autopilot is not None else None)
        read = reader(message) if reader is not None else []
        home, lost_fix = copy(self._home), copy(self._lost_fix)
        told = home.correct(read, self.seen(Armed) == Armed(True))
        told = lost_fix.correct(told, self.seen(Health), now_ms)
        for state in (*read, *told):
            check_range(state)
        self._home, self._lost_fix = home, lost_fix
        if kind == "GLOBAL_POSITION_INT":
            self._note_motion(message, now_ms)
        for state in told:
            self.states[state.name] = Seen(state, self.number, now_ms)
        return told

    def _is_of_kind(self, heartbeat: Any) -> bool:
        """Whether a heartbeat is of the same kind as the first; one of another kind is ignored."""
        kind = kind_of(heartbeat)
        if self._autopilot is None and kind is not None:
            self._autopilot, self.mission.home_items = kind, kind.home_items
        return kind is not None and kind is self._autopilot

    def _read_heartbeat(self, message: Any) -> list[State]:
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        known = self.seen(Airframe)
        airframe = Airframe(message.autopilot, message.type, None if known is None else known.version)
        return [Armed(armed), FlightMode(self.autopilot.flight_mode(message)), airframe]

    def _read_status(self, message: Any) -> list[State]:
        return [self.autopilot.health(message), *_power(message)]

    def _read_version(self, message: Any) -> list[State]:
        """The airframe with its version; 0 is MAVLink's unknown version."""
        known = self.seen(Airframe)
        if known is None or message.flight_sw_version == 0:
            return []
        return [replace(known, version=message.flight_sw_version)]

    def _read_parameter(self, message: Any) -> list[State]:
        name, value = message.param_id, message.param_value
        if not math.isfinite(value):
            return []
        if name in self.autopilot.cruise_speed:
            self.cruise_m_s = value * self.autopilot.cruise_speed[name]
        if name in self.autopilot.max_speed:
            return [MaxGroundspeed(value * self.autopilot.max_speed[name])]
        return []

    def _note_motion(self, message: Any, now_ms: int) -> None:
        """Keep the times at which the drone stood still, back to the last one that is a second old."""
        across_m_s, climb_m_s = math.hypot(message.vx, message.vy) / 100, abs(message.vz) / 100
        if across_m_s > STILL_M_S or climb_m_s > STILL_CLIMB_M_S:
            self._still.clear()
            return
        self._still.append((self.number, now_ms))
        while len(self._still) > 1 and now_ms - self._still[1][1] >= STILL_MS:
            del self._still[0]


def _battery(message: Any) -> list[State]:
    if message.id != 0 or message.battery_remaining < 0:
        return []
    return [Battery(min(100, message.battery_remaining))]


def _position(message: Any) -> list[State]:
    told: list[State] = [
        Location(message.lat / 1e7, message.lon / 1e7, message.alt / 1000, message.relative_alt / 1000)
    ]
    if message.hdg < 36_000:
        told.append(Heading(message.hdg / 100))
    return [*told, VelocityNed(message.vx / 100, message.vy / 100, message.vz / 100)]


def _gps(message: Any) -> list[State]:
    if message.fix_type not in list(GpsFix):
        return []
    satellites = None if message.satellites_visible == UNKNOWN_U8 else message.satellites_visible
    return [Gps(GpsFix(message.fix_type), satellites, None if message.eph == UNKNOWN_U16 else message.eph / 100)]


def _power(message: Any) -> list[State]:
    """The power state; a current of -1 is not measured."""
    if message.voltage_battery == UNKNOWN_U16:
        return []
    current_a = None if message.current_battery < 0 else message.current_battery / 100
    return [Power(message.voltage_battery / 1000, current_a)]


def _vfr_hud(message: Any) -> list[State]:
    return [Groundspeed(message.groundspeed)] if math.isfinite(message.groundspeed) else []


def _landed(message: Any) -> list[State]:
    return [LandedState(Landed(message.landed_state))] if message.landed_state in list(Landed) else []


def _home(message: Any) -> list[State]:
    return [Home(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1000)]


_READERS = {
    "BATTERY_STATUS": _battery,
    "GLOBAL_POSITION_INT": _position,
    "GPS_RAW_INT": _gps,
    "VFR_HUD": _vfr_hud,
    "EXTENDED_SYS_STATE": _landed,
    "HOME_POSITION": _home,
}
SOURCES = {
    "battery": "BATTERY_STATUS",
    "location": "GLOBAL_POSITION_INT",
    "heading": "GLOBAL_POSITION_INT",
    "groundspeed": "VFR_HUD",
    "flight_mode": "HEARTBEAT",
    "armed": "HEARTBEAT",
    "landed_state": "EXTENDED_SYS_STATE",
    "home": "HOME_POSITION",
    "health": "SYS_STATUS",
    "velocity": "GLOBAL_POSITION_INT",
    "gps": "GPS_RAW_INT",
    "power": "SYS_STATUS",
    "airframe": "HEARTBEAT",
    "mission": "MISSION_CURRENT",
    "fence": "FENCE_STATUS",
}
"""The message that carries each state, except states from parameters and texts."""
