"""Whether a running command can still have its effect: a pilot may have taken over, or stopped the motors."""

from __future__ import annotations

from ..protocol.commands import Goto, Offboard, Takeoff
from ..protocol.states import FlightMode, FlightModeName
from .mavlink.plans import is_disarmed
from .mavlink.vehicle import Vehicle
from .runs import Phase, Run, Runs

MODE_GRACE_MS = 3000
"""How long a mode that is not the command's own may last: the change may still be under way."""


def interrupted(run: Run, runs: Runs, vehicle: Vehicle, now_ms: int) -> str | None:
    """Why a running command can no longer have its effect, None while it can."""
    if run.plan.modes is None or any(r.phase is Phase.SENT and r.is_of_group(run) for r in runs):
        return None
    if isinstance(run.command, Takeoff | Goto | Offboard) and is_disarmed(vehicle, run.accepted_number):
        return "disarmed"
    told = vehicle.seen(FlightMode, run.accepted_number)
    if told is None:
        return None
    if told.mode in run.plan.modes:
        run.entered_mode = True
        run.passing_since_ms = None
        return None
    if run.entered_mode and not _is_passing(run, vehicle, told.mode):
        return "mode_changed"
    if run.passing_since_ms is None:
        run.passing_since_ms = now_ms
    return "mode_changed" if now_ms - run.passing_since_ms > MODE_GRACE_MS else None


def _is_passing(run: Run, vehicle: Vehicle, mode: FlightModeName) -> bool:
    """Whether the autopilot itself may have gone on to a mode, because the effect is about to show."""
    near = run.plan.near
    return mode in run.plan.passing and (near is None or near(vehicle, run.accepted_number))
