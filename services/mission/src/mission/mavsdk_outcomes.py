"""MAVSDK's results and telemetry in MQTT-XT's terms: a drone's known state, and the proof of a command's effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from mavsdk.plugins.action import ActionResult
from mavsdk.plugins.mission_raw import MissionRawResult
from mavsdk.plugins.offboard import OffboardResult
from mavsdk.plugins.telemetry import FlightMode, LandedState, Position

from mqttxt import Arm, FlightModeName, Goto, Land, Landed, Return, StartMission, Takeoff, UploadPlan, Word
from mqttxt.drone.mavlink.plans import ALTITUDE_REACHED_M, ARRIVED_ACROSS_M, ARRIVED_ALTITUDE_M
from mqttxt.protocol.commands import haversine_m

from .fleet import Point, Status

Value = TypeVar("Value")

_WORDS: Final[dict[str, tuple[Word, str | None]]] = {
    "NO_SYSTEM": (Word.UNREACHABLE, "no_system"),
    "CONNECTION_ERROR": (Word.UNREACHABLE, "connection_error"),
    "DENIED": (Word.DENIED, "autopilot"),
    "COMMAND_DENIED": (Word.DENIED, "autopilot"),
    "COMMAND_DENIED_LANDED_STATE_UNKNOWN": (Word.DENIED, "landed_state_unknown"),
    "COMMAND_DENIED_NOT_LANDED": (Word.DENIED, "not_landed"),
    "TIMEOUT": (Word.UNCONFIRMED, "timeout"),
    "UNSUPPORTED": (Word.UNSUPPORTED, None),
    "FAILED": (Word.FAILED, "autopilot"),
}
"""Last words by the names of MAVSDK's results; any other is `failed`, with the name as the reason."""

_MODES: Final[dict[FlightMode, FlightModeName]] = {
    FlightMode.TAKEOFF: FlightModeName.TAKEOFF,
    FlightMode.HOLD: FlightModeName.HOLD,
    FlightMode.MISSION: FlightModeName.MISSION,
    FlightMode.RETURN_TO_LAUNCH: FlightModeName.RETURN,
    FlightMode.LAND: FlightModeName.LAND,
    FlightMode.OFFBOARD: FlightModeName.OFFBOARD,
    FlightMode.FOLLOW_ME: FlightModeName.FOLLOW,
    FlightMode.MANUAL: FlightModeName.MANUAL,
    FlightMode.ALTCTL: FlightModeName.ALTITUDE,
    FlightMode.POSCTL: FlightModeName.POSITION,
    FlightMode.ACRO: FlightModeName.ACRO,
    FlightMode.STABILIZED: FlightModeName.STABILIZED,
}

_LANDED: Final[dict[LandedState, Landed]] = {
    LandedState.UNKNOWN: Landed.UNDEFINED,
    LandedState.ON_GROUND: Landed.ON_GROUND,
    LandedState.IN_AIR: Landed.IN_AIR,
    LandedState.TAKING_OFF: Landed.TAKEOFF,
    LandedState.LANDING: Landed.LANDING,
}


def refusal(result: ActionResult | MissionRawResult | OffboardResult) -> tuple[Word, str | None]:
    """The last word and its reason for any result of a MAVSDK plugin except success.

    MAVSDK gives COMMAND_DENIED for both MAV_RESULT_DENIED and MAV_RESULT_TEMPORARILY_REJECTED.
    """
    return _WORDS.get(result.name, (Word.FAILED, result.name.lower()))


def mode_of(mode: FlightMode) -> FlightModeName:
    """MQTT-XT's name of a flight mode; UNKNOWN for one without a name."""
    return _MODES.get(mode, FlightModeName.UNKNOWN)


def landed_of(state: LandedState) -> Landed:
    """MQTT-XT's name of a landed state."""
    return _LANDED[state]


@dataclass(frozen=True)
class DronePosition:
    """A drone's position; `altitude_m` is in metres above home, as GLOBAL_POSITION_INT.relative_alt."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    altitude_m: float


def place_of(found: Position) -> DronePosition:
    """MAVSDK's position as a place."""
    return DronePosition(found.latitude_deg, found.longitude_deg, found.absolute_altitude_m, found.relative_altitude_m)


@dataclass(frozen=True)
class TimedValue(Generic[Value]):
    """A value and when its message was received, in seconds of the event loop's clock."""

    value: Value
    at_s: float


@dataclass
class View:
    """A drone's newest telemetry. `tells_landed`: its streams carry EXTENDED_SYS_STATE."""

    tells_landed: bool
    armed: TimedValue[bool] | None = None
    mode: TimedValue[FlightModeName] | None = None
    place: TimedValue[DronePosition] | None = None
    landed: TimedValue[Landed] | None = None

    @property
    def missing(self) -> list[str]:
        """The states that have not arrived yet, by MQTT-XT's names."""
        told: dict[str, object] = {"armed": self.armed, "flight_mode": self.mode, "location": self.place}
        if self.tells_landed:
            told["landed_state"] = self.landed
        return [name for name, found in told.items() if found is None]

    @property
    def home_amsl_m(self) -> float:
        """Home's altitude above sea level, m; only valid once the position has arrived."""
        assert self.place is not None
        return self.place.value.altitude_amsl_m - self.place.value.altitude_m

    @property
    def status(self) -> Status:
        return Status(
            armed=self.armed.value if self.armed else None,
            mode=self.mode.value.label if self.mode else None,
            altitude_m=self.place.value.altitude_m if self.place else None,
            landed=self.landed.value.label if self.landed else None,
        )

    def is_landed_as(self, wanted: Landed, since_s: float) -> bool:
        """Whether telemetry since then has shown the landed state; true if the streams do not carry it."""
        return not self.tells_landed or since(self.landed, since_s) == wanted


def since(told: TimedValue[Value] | None, since_s: float) -> Value | None:
    """The value, if it arrived at `since_s` or later."""
    return told.value if told is not None and told.at_s >= since_s else None


@dataclass(frozen=True)
class Goal:
    """A command's effect: its proof, the modes it runs in, and the time it may take.

    `reached(view, since_s)` uses only telemetry since the call. `passing` are modes that may follow its own.
    """

    reached: Callable[[View, float], bool]
    limit_s: float
    modes: frozenset[FlightModeName] = frozenset()
    passing: frozenset[FlightModeName] = frozenset()
    needs_armed: bool = False

    def failure(self, view: View, accepted_s: float, entered: bool) -> str | None:
        """Why the effect can no longer be reached, None while it can. `entered`: one of its modes has been shown."""
        if self.needs_armed and since(view.armed, accepted_s) is False:
            return "disarmed"
        mode = since(view.mode, accepted_s)
        if entered and mode is not None and mode not in self.modes | self.passing:
            return "mode_changed"
        return None


def arm_goal() -> Goal:
    """A heartbeat shows that the drone is armed."""
    return Goal(lambda view, since_s: since(view.armed, since_s) is True, Arm.limit_s)


def takeoff_goal(altitude_m: float) -> Goal:
    """In the air and at most half a metre, or 5 % of the altitude, below it."""
    enough_m = altitude_m - max(ALTITUDE_REACHED_M, 0.05 * altitude_m)

    def reached(view: View, since_s: float) -> bool:
        place = since(view.place, since_s)
        return place is not None and place.altitude_m >= enough_m and view.is_landed_as(Landed.IN_AIR, since_s)

    own, passing = frozenset({FlightModeName.TAKEOFF}), frozenset({FlightModeName.HOLD})
    return Goal(reached, Takeoff.limit_s, own, passing, needs_armed=True)


def goto_goal(point: Point) -> Goal:
    """At the point, within MQTT-XT's limits."""

    def reached(view: View, since_s: float) -> bool:
        place = since(view.place, since_s)
        if place is None or abs(place.altitude_m - point.altitude_m) > ARRIVED_ALTITUDE_M:
            return False
        left_m = haversine_m(place.latitude_deg, place.longitude_deg, point.latitude_deg, point.longitude_deg)
        return left_m <= ARRIVED_ACROSS_M

    return Goal(reached, Goto.limit_s, frozenset({FlightModeName.HOLD}), needs_armed=True)


def land_goal() -> Goal:
    """On the ground and disarmed."""
    return Goal(_is_down, Land.limit_s, frozenset({FlightModeName.LAND}))


def return_goal() -> Goal:
    """On the ground and disarmed; some autopilots change to their landing mode at the end."""
    return Goal(_is_down, Return.limit_s, frozenset({FlightModeName.RETURN, FlightModeName.LAND}))


def uploaded_goal() -> Goal:
    """Reached at once: only the acknowledgement shows that a mission was uploaded."""
    return Goal(lambda view, since_s: True, UploadPlan.limit_s)


def survey_goal() -> Goal:
    """On the ground and disarmed, after the mission's own return."""
    passing = {FlightModeName.TAKEOFF, FlightModeName.HOLD, FlightModeName.RETURN, FlightModeName.LAND}
    return Goal(_is_down, StartMission.limit_s, frozenset({FlightModeName.MISSION}), frozenset(passing))


def _is_down(view: View, since_s: float) -> bool:
    return since(view.armed, since_s) is False and view.is_landed_as(Landed.ON_GROUND, since_s)


WINDOW_S = 4.0
MOST_IN_WINDOW = 6
"""The most heartbeats of one vehicle in a window: one per second, so at most five, and a late one."""


class HeartbeatCount:
    """Detects two vehicles with one system id by their heartbeats: each vehicle sends one per second (MAVLink).

    MAVSDK gives neither the connection nor the address of a message. Two consecutive windows must have too many, so
    that a queue that empties is not taken for a vehicle. A second vehicle that loses half of its heartbeats, or appears
    later, is not detected; a vehicle that is received over two ways looks like two.
    """

    def __init__(self) -> None:
        self._began_s: float | None = None
        self._count = 0
        self._too_many = 0
        self.is_one = False

    @property
    def is_two(self) -> bool:
        return self._too_many >= 2

    def heard(self, at_s: float) -> None:
        """Count a heartbeat, until one vehicle or two are established."""
        if self.is_one or self.is_two:
            return
        if self._began_s is None:
            self._began_s = at_s
        if at_s - self._began_s >= WINDOW_S:
            self._too_many = self._too_many + 1 if self._count > MOST_IN_WINDOW else 0
            self.is_one = self._too_many == 0
            self._began_s, self._count = at_s, 0
        self._count += 1
