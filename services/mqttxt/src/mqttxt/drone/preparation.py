"""The mode that an autopilot has to be in before a command is written to it (docs/protocol.md, R5.19).

A pilot who changes the mode after it was commanded wins: it is not commanded again, and the command ends.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..protocol.messages import Word
from ..protocol.states import FlightMode, FlightModeName
from .effects import Transmit
from .mavlink.sources import Source
from .mavlink.vehicle import Vehicle
from .runs import Output, Phase, Preparation, Run, Runs

PREPARE_MS = 3000
"""How long a command waits for the mode."""
AGAIN_MS = 500


@dataclass(frozen=True)
class Preparer:
    """Puts one autopilot into the modes that commands need first."""

    vehicle: Vehicle
    runs: Runs

    def is_taken_over(self, run: Run) -> bool:
        """Whether heartbeats since the first write show a mode that is neither the commanded nor the earlier one."""
        prepared = run.preparation
        told = self.vehicle.seen(FlightMode, prepared.number) if prepared is not None else None
        if prepared is None or told is None:
            return False
        if told.mode is prepared.mode:
            prepared.is_entered = True
            return False
        return prepared.is_entered or told != prepared.before

    def prepare(self, run: Run, mode: FlightModeName, now_ms: int) -> list[Output]:
        """Command the mode every `AGAIN_MS` until it is accepted; then wait for a heartbeat that shows it.

        A newer command of another mode ends the run: its mode is not undone.
        """
        if run.newer_modes is not None and mode not in run.newer_modes:
            return [self.runs.end(run, Word.DENIED, "mode_changed")]
        prepared = run.preparation
        if prepared is None:
            run.phase = Phase.PREPARING
            before, number = self.vehicle.seen(FlightMode), self.vehicle.number
            prepared = run.preparation = Preparation(mode, before, number, now_ms)
        elif now_ms > prepared.since_ms + PREPARE_MS:
            return [self.runs.end(run, Word.DENIED, "mode_changed" if prepared.accepted else "wrong_mode")]
        elif prepared.accepted or prepared.is_outdated or now_ms < run.last_send_ms + AGAIN_MS:
            return []
        message = self.vehicle.autopilot.set_mode(self.vehicle, mode)
        key = message.command, Source.COMPANION
        if self.runs.awaiting(key) is not None:
            return []
        run.last_send_ms = now_ms
        prepared.writes += 1
        self.runs.acks.expect(key, now_ms, run.id)
        return [Transmit(message, run.deadline_ms)]
