"""Offboard: set-points streamed on the drone itself, from before the mode changes until it has changed back.

They end at the end of the duration, when the control lease ends, and at the limit: hold is commanded, and the
set-points brake until a heartbeat shows another mode. A mode that was not commanded is a pilot's: the set-points stop
at once, and nothing is commanded.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from ..protocol.commands import Offboard
from ..protocol.messages import Word
from ..protocol.states import FlightMode
from .effects import Transmit
from .held_lease import HeldLease
from .mavlink.set_points import set_point
from .mavlink.sources import Source
from .mavlink.vehicle import Vehicle
from .runs import Output, Phase, Run, Runs

SET_POINT_MS = 50
"""20 Hz, as in MAVSDK; PX4 leaves the mode after COM_OF_LOSS_T (1 s) without set-points."""
EARLY_MS = 10
"""How early a set-point may be written: a tick may come just before it is due, and the next would halve the rate."""
LEASE_MS = 3000
"""How long after the start set-points go on without a newer lease."""
STOP_MS = 3000
"""How long to wait for the mode to change back before the set-points stop in any case."""
HOLD_AGAIN_MS = 500


@dataclass
class Ending:
    """The last word of a stopping run, given once a message after number `after` shows another mode."""

    word: Word
    reason: str | None
    since_ms: int
    after: int
    next_hold_ms: int


@dataclass
class OffboardFlight:
    """The set-points of one offboard command."""

    command: Offboard
    next_ms: int
    written: int = 0
    ending: Ending | None = None


class OffboardPilot:
    """Flies the offboard commands among the runs of one autopilot, as long as `lease` lets them go on."""

    def __init__(self, vehicle: Vehicle, runs: Runs, lease: HeldLease) -> None:
        self._lease = lease
        self._vehicle = vehicle
        self._runs = runs
        self.unsure_after = -1
        """The newest message before the process last stood still: a pilot may have taken over since."""
        self._flights: dict[Run, OffboardFlight] = {}

    def refusal(self, gs_session: int, now_ms: int) -> str | None:
        """Why a station's offboard command must not start now, None if it may."""
        if not self._has_control(gs_session, now_ms):
            return "no_lease"
        own = any(run.phase not in (Phase.WAITING, Phase.PRIMING) for run in self._offboards())
        if self._vehicle.autopilot.is_offboard_alone and self._is_offboard() and not own:
            return "offboard_elsewhere"
        return None

    def needs_priming(self, run: Run) -> bool:
        """Whether set-points must precede the mode: not while those of an older command are already streamed."""
        return self._vehicle.autopilot.priming > 0 and not any(
            other.phase in (Phase.SENT, Phase.RUNNING) for other in self._offboards() if other is not run
        )

    def begin(self, run: Run, now_ms: int) -> None:
        """Start the run's set-points; the first is due at once."""
        assert isinstance(run.command, Offboard)
        self._flights.setdefault(run, OffboardFlight(run.command, now_ms))

    def is_primed(self, run: Run) -> bool:
        flight = self._flights.get(run)
        return flight is not None and flight.written >= self._vehicle.autopilot.priming

    def over(self, run: Run, now_ms: int) -> tuple[Word, str | None] | None:
        """The last word of a running flight that has to stop now, None while it goes on."""
        assert isinstance(run.command, Offboard)
        if not self._vehicle.is_alive(now_ms):
            return Word.UNCONFIRMED, "autopilot_lost"
        if self.has_lost_lease(run, now_ms):
            return Word.FAILED, "lease_lost"
        if now_ms >= run.started_ms + run.limit_ms:
            return Word.FAILED, "timeout"
        if run.entered_mode and now_ms >= run.accepted_ms + round(run.command.duration_s * 1000):
            return Word.COMPLETED, None
        return None

    def has_lost_lease(self, run: Run, now_ms: int) -> bool:
        """Whether a flight may not go on, or begin, for want of a lease."""
        until_ms = max(run.started_ms + LEASE_MS, self._lease.offboard_until_ms or 0)
        return not self._has_control(run.id.gs_session, now_ms) or (
            run.phase is not Phase.WAITING and now_ms > until_ms
        )

    def stop(self, run: Run, word: Word, reason: str | None, now_ms: int) -> list[Output]:
        """Command hold and brake; `word` is given once the mode has changed. If a newer flight runs, only end `run`."""
        newer = self._runs.newer(run)
        if newer is not None and newer.is_under_way:
            return [self._runs.end(run, word, reason)]
        if self._has_left(run):
            if word is Word.COMPLETED:
                return [self._runs.end(run, Word.FAILED, "mode_changed")]
            return [self._runs.end(run, word, reason)]
        run.phase = Phase.STOPPING
        self.begin(run, now_ms)
        self._flights[run].ending = Ending(word, reason, now_ms, self._vehicle.number, now_ms)
        return self.go_on_stopping(run, now_ms)

    def go_on_stopping(self, run: Run, now_ms: int) -> list[Output]:
        """The last word once the mode has changed or after `STOP_MS`; until then hold every `HOLD_AGAIN_MS`."""
        ending = self._flights[run].ending
        assert ending is not None
        told = self._vehicle.seen(FlightMode, ending.after)
        if told is not None and told.mode is not self._vehicle.autopilot.offboard_mode:
            return [self._runs.end(run, ending.word, ending.reason)]
        if now_ms >= ending.since_ms + STOP_MS:
            if not self._vehicle.is_alive(now_ms):
                return [self._runs.end(run, Word.UNCONFIRMED, "autopilot_lost")]
            if ending.word is Word.COMPLETED:
                return [self._runs.end(run, Word.FAILED, "no_hold")]
            return [self._runs.end(run, ending.word, ending.reason)]
        newer = self._runs.newer(run)
        if now_ms < ending.next_hold_ms or newer is not None or self.is_unsure:
            return []
        ending.next_hold_ms = now_ms + HOLD_AGAIN_MS
        self._runs.acks.expect((mavlink.MAV_CMD_DO_SET_MODE, Source.COMPANION), now_ms)
        return [self._hold()]

    def superseded(self, run: Run) -> tuple[Word, str | None]:
        """The last word of a run that a newer flight superseded."""
        flight = self._flights.get(run)
        if flight is None or flight.ending is None or flight.ending.word is Word.COMPLETED:
            return Word.SUPERSEDED, None
        return flight.ending.word, flight.ending.reason

    def set_points(self, now_ms: int) -> list[Output]:
        """The set-point that is due, if any; missed ones are left out.

        Until the command is accepted, its deadline bounds the set-points too.
        """
        run = self._streaming()
        if run is None or now_ms < self._flights[run].next_ms - EARLY_MS:
            return []
        flight = self._flights[run]
        late = now_ms - flight.next_ms >= SET_POINT_MS
        flight.next_ms = now_ms + SET_POINT_MS if late else flight.next_ms + SET_POINT_MS
        flight.written += 1
        message = set_point(flight.command, self._vehicle, now_ms, braking=flight.ending is not None)
        started = run.phase in (Phase.RUNNING, Phase.STOPPING)
        return [Transmit(message, None if started else run.deadline_ms)]

    @property
    def is_unsure(self) -> bool:
        """Whether no heartbeat has shown the mode since the process last stood still."""
        return self.unsure_after >= 0 and self._vehicle.seen(FlightMode, self.unsure_after) is None

    def leave(self, now_ms: int) -> list[Output]:
        """Stop every flight that the autopilot may follow before the process ends."""
        flown = [run for run in self._offboards() if run.phase in (Phase.SENT, Phase.RUNNING)]
        return [output for run in flown for output in self.stop(run, Word.FAILED, "cancelled", now_ms)]

    def _has_left(self, run: Run) -> bool:
        """Whether a heartbeat shows that the autopilot has left offboard since the write, or never entered it."""
        told = self._vehicle.seen(FlightMode, run.sent_number)
        if told is None or told.mode is self._vehicle.autopilot.offboard_mode:
            return False
        return run.entered_mode or told.mode not in run.modes_before

    def _hold(self) -> Transmit:
        autopilot = self._vehicle.autopilot
        return Transmit(autopilot.set_mode(self._vehicle, autopilot.hold_mode))

    def _has_control(self, gs_session: int, now_ms: int) -> bool:
        """Whether the control lease has not ended and is this station's."""
        return self._lease.is_held(now_ms) and self._lease.holder_session in (None, gs_session)

    def _offboards(self) -> list[Run]:
        return [run for run in self._runs if isinstance(run.command, Offboard)]

    def _streaming(self) -> Run | None:
        """The oldest flight that has begun. A newer one ends it, and takes over, once it is accepted."""
        if self._flights:
            self._flights = {run: flight for run, flight in self._flights.items() if self._runs.find(run.id) is run}
        return next((run for run in self._flights if run.phase is not Phase.WAITING), None)

    def _is_offboard(self) -> bool:
        return self._vehicle.seen(FlightMode) == FlightMode(self._vehicle.autopilot.offboard_mode)
