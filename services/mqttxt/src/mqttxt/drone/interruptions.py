"""Whether a running command can still have its effect: a pilot may have taken over, or stopped the motors."""

from __future__ import annotations

from ..protocol.commands import Goto, Hold, Offboard, Pause, Resume, StartMission, Takeoff
from ..protocol.states import FlightMode, FlightModeName
from .mavlink.plans import is_disarmed
from .mavlink.vehicle import Vehicle
from .runs import Phase, Run, Runs

_IN_THE_AIR = (Takeoff, Goto, Offboard, StartMission, Resume)
MODE_GRACE_MS = 3000
"""How long another mode than the command's may show: an earlier one, or one that it passes through."""
SETTLED_MS = 200
"""The age of an acceptance from which on heartbeats are newer than its change of mode."""


def interrupted(run: Run, runs: Runs, vehicle: Vehicle, now_ms: int) -> str | None:
    """The reason why a running command can no longer have its effect, None while it can."""
    if run.plan.modes is None or any(r.phase is Phase.SENT and r.is_of_group(run) for r in runs):
        return None
    may_land = isinstance(run.command, StartMission | Resume) and vehicle.mission.is_landing
    if isinstance(run.command, _IN_THE_AIR) and not may_land and is_disarmed(vehicle, run.accepted_number):
        return "disarmed"
    if run.settled_number is None and now_ms >= run.accepted_ms + SETTLED_MS:
        run.settled_number = vehicle.number
    told = vehicle.seen(FlightMode, run.accepted_number)
    if told is None:
        return None
    if told.mode in run.plan.modes:
        run.entered_mode = True
        run.passing_since_ms = None
        return None
    if not _may_last(run, vehicle, told.mode):
        return "mode_changed"
    if run.passing_since_ms is None:
        run.passing_since_ms = now_ms
    return "mode_changed" if now_ms - run.passing_since_ms > MODE_GRACE_MS else None


def is_taken_over(run: Run, vehicle: Vehicle) -> bool:
    """Whether a heartbeat since the write of an unacknowledged command shows that somebody changed the mode.

    Such a heartbeat shows a mode that is neither the command's own nor that of a write, or the latter after the former.
    """
    told = vehicle.seen(FlightMode, run.sent_number)
    if run.plan.modes is None or told is None:
        return False
    if told.mode in run.plan.modes:
        run.entered_mode = True
        return False
    return run.entered_mode or told.mode not in run.modes_before


def is_overridden(run: Run, runs: Runs, vehicle: Vehicle) -> bool:
    """Whether somebody changed the mode while a command waited for its first write; a hold is written in any mode.

    Hold, the command's own modes and those of other written commands are not somebody's.
    """
    told = vehicle.seen(FlightMode, run.begun_number)
    if run.plan.modes is None or told is None or isinstance(run.command, Hold | Pause):
        return False
    own = run.begun_modes | run.plan.modes | {vehicle.autopilot.hold_mode, run.plan.first_mode}
    return told.mode not in own | runs.own_modes(besides=run)


def modes_shown(vehicle: Vehicle) -> frozenset[FlightModeName]:
    """The autopilot's mode by its newest heartbeat; empty without one."""
    told = vehicle.seen(FlightMode)
    return frozenset() if told is None else frozenset({told.mode})


def _may_last(run: Run, vehicle: Vehicle, mode: FlightModeName) -> bool:
    """Whether the autopilot may be in a mode other than the command's, for a while.

    Either the autopilot has passed on to it because the effect is near, or it is still in an earlier mode.
    """
    near = run.plan.near
    if mode in run.plan.passing and (near is None or near(vehicle, run.accepted_number)):
        return True
    has_settled = run.settled_number is not None and vehicle.seen(FlightMode, run.settled_number) is not None
    return not run.entered_mode and (mode in run.modes_before or not has_settled)
