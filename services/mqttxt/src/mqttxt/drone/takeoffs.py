"""Keeps a takeoff or mission that a disarmed autopilot accepted from flying off when the drone is armed later."""

from __future__ import annotations

from ..protocol.commands import Command, Resume, StartMission, Takeoff
from ..protocol.states import Armed, FlightMode, FlightModeName
from .effects import Transmit
from .mavlink.sources import Source
from .mavlink.vehicle import Vehicle
from .runs import Output, Runs

ENTER_MS = 10_000
"""How long after a write it may still make the autopilot enter the mode."""
HOLD_AGAIN_MS = 500
_MODES: dict[type[Command], FlightModeName] = {
    Takeoff: FlightModeName.TAKEOFF,
    StartMission: FlightModeName.MISSION,
    Resume: FlightModeName.MISSION,
}
"""The modes in which a disarmed autopilot waits and, once it is armed, flies off."""


class Takeoffs:
    """Commands hold while the autopilot, as PX4 may, stays disarmed in a mode of the client's in which it takes off."""

    def __init__(self, vehicle: Vehicle, runs: Runs) -> None:
        self._vehicle = vehicle
        self._runs = runs
        self._said_ms: int | None = None
        self._said_number = 0
        self._mode = FlightModeName.TAKEOFF
        self._entered = False
        self._next_hold_ms = 0
        self._before: tuple[int | None, int, FlightModeName, bool] = None, 0, self._mode, False
        """What was noted before the newest command."""

    def said(self, command: Command, now_ms: int) -> None:
        """Note that a command is being written."""
        if type(command) not in _MODES:
            return
        self._before = self._said_ms, self._said_number, self._mode, self._entered
        self._said_ms, self._said_number, self._entered = now_ms, self._vehicle.number, False
        self._mode = _MODES[type(command)]

    def unsaid(self, command: Command) -> None:
        """The newest of these commands was never written: a mode is a pilot's, or the one's before."""
        if type(command) in _MODES:
            self._said_ms, self._said_number, self._mode, self._entered = self._before

    def undo(self, now_ms: int) -> list[Output]:
        """Command hold every `HOLD_AGAIN_MS` while the autopilot is disarmed in the command's mode."""
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
