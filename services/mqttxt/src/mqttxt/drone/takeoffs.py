"""A takeoff or a mission that came while the motors were disarmed must not fly off when somebody arms them later."""

from __future__ import annotations

from ..protocol.commands import Command, Resume, StartMission, Takeoff
from ..protocol.states import Armed, FlightMode, FlightModeName
from .effects import Transmit
from .mavlink.sources import Source
from .mavlink.vehicle import Vehicle
from .runs import Output, Runs

ENTER_MS = 10_000
"""How long after a write the autopilot may enter the mode because of it."""
HOLD_AGAIN_MS = 500
_MODES: dict[type[Command], FlightModeName] = {
    Takeoff: FlightModeName.TAKEOFF,
    StartMission: FlightModeName.MISSION,
    Resume: FlightModeName.MISSION,
}
"""The modes in which a disarmed autopilot waits, and flies off once it is armed."""


class Takeoffs:
    """Whether a disarmed autopilot is in a mode of ours to take off in, as PX4 may stay; then hold is commanded."""

    def __init__(self, vehicle: Vehicle, runs: Runs) -> None:
        self._vehicle = vehicle
        self._runs = runs
        self._said_ms: int | None = None
        self._said_number = 0
        self._mode = FlightModeName.TAKEOFF
        self._entered = False
        self._next_hold_ms = 0

    def said(self, command: Command, now_ms: int) -> None:
        """A command is being written."""
        if type(command) not in _MODES:
            return
        self._mode = _MODES[type(command)]
        self._said_ms, self._said_number, self._entered = now_ms, self._vehicle.number, False

    def undo(self, now_ms: int) -> list[Output]:
        """Command hold, now and then, while the autopilot is disarmed in the mode that our command left it in."""
        if self._said_ms is None:
            return []
        told = self._vehicle.seen(FlightMode, self._said_number)
        if told is None:
            return []
        is_in = told.mode is self._mode
        if not is_in and (self._entered or now_ms > self._said_ms + ENTER_MS):
            self._said_ms = None
        self._entered = is_in
        is_open = any(type(run.command) in _MODES for run in self._runs)
        if not is_in or is_open or self._vehicle.seen(Armed) != Armed(False) or now_ms < self._next_hold_ms:
            return []
        autopilot = self._vehicle.autopilot
        message = autopilot.set_mode(self._vehicle, autopilot.hold_mode)
        if self._runs.awaiting((message.command, Source.COMPANION)) is not None:
            return []
        self._next_hold_ms = now_ms + HOLD_AGAIN_MS
        self._runs.acks.expect((message.command, Source.COMPANION), now_ms)
        return [Transmit(message)]
