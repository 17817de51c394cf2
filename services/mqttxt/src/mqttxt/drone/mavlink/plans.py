"""Commands as an autopilot gets them: a MAVLink message, and the proof of its effect."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import TYPE_CHECKING, Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.commands import Arm, Command, Disarm, Goto, Offboard, Resume, StartMission, Takeoff, haversine_m
from ...protocol.states import Armed, FlightMode, FlightModeName, Home, Landed, LandedState, Location

if TYPE_CHECKING:
    from .vehicle import Vehicle

AUTOPILOT_COMPONENT: Final[int] = mavlink.MAV_COMP_ID_AUTOPILOT1
NAN = float("nan")
ARRIVED_ACROSS_M = 2.0
ARRIVED_ALTITUDE_M = 1.0
ALTITUDE_REACHED_M = 0.5
"""How far below its target altitude a takeoff counts as completed; at least 5 % of the altitude."""
ALTITUDE_NEAR_M = 2.0
"""How far below its target altitude an autopilot may end its takeoff (PX4: NAV_MC_ALT_RAD); at least 10 %."""

LANDED_MS = 3000
"""How long a landed state is valid without a newer one; PX4, or the UAV client's request, gives five per second."""

Effect = Callable[["Vehicle", int], bool]
"""Whether messages after number `after` show a command's effect: `effect(vehicle, after)`."""


class Group(Enum):
    """Commands of one group supersede each other; those without a group (None) stand alone."""

    ARMING = auto()
    MOTION = auto()


class CannotExecute(Exception):
    """The command cannot be written to this autopilot now; the text is the outcome's reason."""


@dataclass(frozen=True)
class CommandPlan:
    """A command as one MAVLink message, the modes in which it runs, and the proof of its effect.

    `first_mode`: the mode that the autopilot is put into before the message is sent, None if its mode is right.
    `modes` None: the command does not depend on a mode. `passing` are modes that are right once the effect is `near`,
    and only if it shows soon after. `message` None: nothing has to be sent. `on_accepted(now_ms)` is called when the
    command is accepted. `is_said_once`: it is sent once, and its acceptance is the only sign of its effect.
    """

    message: Any
    mav_cmd: int
    group: Hashable
    effect: Effect
    modes: frozenset[FlightModeName] | None = None
    passing: frozenset[FlightModeName] = frozenset()
    near: Effect | None = None
    first_mode: FlightModeName | None = None
    on_accepted: Callable[[int], None] | None = None
    is_said_once: bool = False


def command_long(vehicle: Vehicle, command: int, *params: float) -> Any:
    """A MAV_CMD to the autopilot as COMMAND_LONG; parameters that are not given are 0."""
    padded = (*params, *[0.0] * (7 - len(params)))
    return mavlink.MAVLink_command_long_message(vehicle.system_id, AUTOPILOT_COMPONENT, command, 0, *padded)


def arming(command: Arm | Disarm, vehicle: Vehicle) -> CommandPlan:
    """COMPONENT_ARM_DISARM, never forced."""
    wanted = isinstance(command, Arm)

    def effect(seen: Vehicle, after: int) -> bool:
        return seen.seen(Armed, after) == Armed(wanted)

    message = command_long(vehicle, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0 if wanted else 0.0)
    return CommandPlan(message, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, Group.ARMING, effect)


def check(command: Command, vehicle: Vehicle, now_ms: int) -> None:
    """Raises CannotExecute for a command that an autopilot may accept, but that must not be written to it now.

    On the ground, `goto` takes off, and a `takeoff` sent while disarmed climbs as soon as somebody arms the drone.
    """
    if isinstance(command, Goto):
        landed = landed_state(vehicle, now_ms)
        if landed is Landed.UNDEFINED:
            raise CannotExecute("landed_state_unknown")
        if landed is Landed.ON_GROUND:
            raise CannotExecute("on_ground")
    if isinstance(command, Takeoff | Goto | Offboard | StartMission | Resume) and vehicle.seen(Armed) != Armed(True):
        raise CannotExecute("disarmed")


def landed_state(vehicle: Vehicle, now_ms: int) -> Landed:
    """The newest landed state; UNDEFINED if none arrived within `LANDED_MS`."""
    told = vehicle.seen(LandedState)
    is_old = vehicle.age_ms(LandedState.name, now_ms) > LANDED_MS
    return Landed.UNDEFINED if told is None or is_old else told.landed


def home_altitude_m(vehicle: Vehicle) -> float:
    """Home's altitude above mean sea level, m. Raises CannotExecute while it is unknown."""
    home = vehicle.seen(Home)
    if home is None:
        raise CannotExecute("home_unknown")
    return home.altitude_amsl_m


def above(altitude_amsl_m: float) -> Effect:
    """The effect: not below an altitude in metres above mean sea level."""

    def effect(seen: Vehicle, after: int) -> bool:
        location = seen.seen(Location, after)
        return location is not None and location.altitude_amsl_m >= altitude_amsl_m

    return effect


def climbed(command: Takeoff, home_m: float) -> Effect:
    """The effect of a takeoff: airborne at its height above home (`home_m` above mean sea level)."""
    is_there = above(home_m + command.altitude_m - max(ALTITUDE_REACHED_M, 0.05 * command.altitude_m))

    def effect(seen: Vehicle, after: int) -> bool:
        return seen.seen(LandedState, after) == LandedState(Landed.IN_AIR) and is_there(seen, after)

    return effect


def arrived(command: Goto, target_m: float) -> Effect:
    """The effect of a goto: at its position, at `target_m` above sea level."""

    def effect(seen: Vehicle, after: int) -> bool:
        location = seen.seen(Location, after)
        if location is None or abs(location.altitude_amsl_m - target_m) > ARRIVED_ALTITUDE_M:
            return False
        left_m = haversine_m(location.latitude_deg, location.longitude_deg, command.latitude_deg, command.longitude_deg)
        return left_m <= ARRIVED_ACROSS_M

    return effect


def reposition(command: Goto, vehicle: Vehicle, frame: int, yaw: float, mode: FlightModeName) -> CommandPlan:
    """A goto as DO_REPOSITION, which also changes the mode to `mode`."""
    target_m = home_altitude_m(vehicle) + command.altitude_m
    message = mavlink.MAVLink_command_int_message(
        vehicle.system_id,
        AUTOPILOT_COMPONENT,
        frame,
        mavlink.MAV_CMD_DO_REPOSITION,
        0,
        0,
        -1.0,
        float(mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE),
        0.0,
        yaw,
        round(command.latitude_deg * 1e7),
        round(command.longitude_deg * 1e7),
        target_m,
    )
    effect = arrived(command, target_m)
    return CommandPlan(message, mavlink.MAV_CMD_DO_REPOSITION, Group.MOTION, effect, frozenset({mode}))


def never(vehicle: Vehicle, after: int) -> bool:
    """No message shows the effect."""
    return False


def holds(vehicle: Vehicle, after: int) -> bool:
    """The autopilot is in its hold mode, and on the ground or standing still in the air."""
    if vehicle.seen(FlightMode, after) != FlightMode(vehicle.autopilot.hold_mode):
        return False
    return vehicle.is_still(after) or vehicle.seen(LandedState, after) == LandedState(Landed.ON_GROUND)


def mission(vehicle: Vehicle, plan: CommandPlan) -> CommandPlan:
    """The plan of a mission's start, completed after the last item, and after the landing if that item lands."""
    lands = vehicle.mission.lands

    def is_over(seen: Vehicle, after: int) -> bool:
        return seen.mission.is_over and (is_down(seen, after) if lands else seen.autopilot.has_ended(seen, after))

    def is_near(seen: Vehicle, after: int) -> bool:
        return seen.mission.is_over or is_disarmed(seen, after)

    modes = {FlightModeName.MISSION, *({FlightModeName.RETURN} if lands else ())}
    return replace(plan, effect=is_over, modes=frozenset(modes), passing=frozenset({FlightModeName.HOLD}), near=is_near)


def check_pause(vehicle: Vehicle) -> None:
    """Raises CannotExecute if no mission is flown."""
    if vehicle.seen(FlightMode) != FlightMode(FlightModeName.MISSION):
        raise CannotExecute("not_in_mission")


def is_disarmed(vehicle: Vehicle, after: int) -> bool:
    """Disarmed, on the ground or not."""
    return vehicle.seen(Armed, after) == Armed(False)


def is_down(vehicle: Vehicle, after: int) -> bool:
    """Landed and disarmed."""
    return vehicle.seen(LandedState, after) == LandedState(Landed.ON_GROUND) and is_disarmed(vehicle, after)
