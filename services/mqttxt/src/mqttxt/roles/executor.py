"""Executes commands on one autopilot over MAVLink, each within its deadline and to its one last word.

COMMAND_ACK carries only the command's number, so at most one command of a MAV_CMD is open at a time, and a
number whose acknowledgement may still be under way is left alone until it came or three seconds have passed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..commands import Command, Goto, Takeoff
from ..dialect.plans import CannotExecute, Plan, plan
from ..dialect.vehicle import Vehicle
from ..messages import CommandId, Word
from ..states import Armed, FlightMode
from .effects import Effect, Log, Transmit

SENDS = 4
RESEND_MS = 500
"""MAVLink's command protocol: repeated until acknowledged; the counts are MAVSDK's."""
STRAY_ACK_MS = 3000
MODE_GRACE_MS = 3000
"""How long a mode that is not the command's own may last: the change may still be under way."""

_FLIGHT_COMMANDS = frozenset(
    {
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_DO_REPOSITION,
        mavlink.MAV_CMD_DO_SET_MODE,
    }
)
_RESULTS = {
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: (Word.DENIED, "temporarily_rejected"),
    mavlink.MAV_RESULT_DENIED: (Word.DENIED, "autopilot"),
    mavlink.MAV_RESULT_UNSUPPORTED: (Word.UNSUPPORTED, None),
    mavlink.MAV_RESULT_FAILED: (Word.FAILED, "autopilot"),
    6: (Word.FAILED, "cancelled"),  # MAV_RESULT_CANCELLED
}


@dataclass(frozen=True)
class Said:
    """A word about a command."""

    id: CommandId
    word: Word
    reason: str | None = None
    percent: int | None = None
    late_ms: int | None = None
    by: CommandId | None = None


class Phase(Enum):
    """Where a command is: waiting for its MAV_CMD to be free, sent and not acknowledged, or accepted."""

    WAITING = auto()
    SENT = auto()
    RUNNING = auto()


@dataclass
class Run:
    """A command that has no last word yet."""

    id: CommandId
    command: Command
    plan: Plan
    deadline_ms: int
    limit_ms: int
    phase: Phase = Phase.WAITING
    sends: int = 0
    acks: int = 0
    last_send_ms: int = 0
    started_ms: int = 0
    accepted_ms: int = 0
    accepted_number: int = 0
    in_progress: bool = False
    entered_mode: bool = False
    passing_since_ms: int | None = None
    late_ms: int | None = None


Output = Effect | Said


@dataclass
class Executor:
    """The commands of one autopilot. Every method returns effects and words, in their order."""

    vehicle: Vehicle
    _runs: list[Run] = field(default_factory=list)
    _barred_until_ms: dict[int, int] = field(default_factory=dict)
    _stray_acks: dict[int, int] = field(default_factory=dict)

    def start(
        self, command_id: CommandId, command: Command, deadline_ms: int, limit_ms: int, now_ms: int
    ) -> list[Output]:
        """Begin a command that was admitted; its first write may have to wait for its MAV_CMD."""
        if not self.vehicle.is_alive(now_ms):
            return [Said(command_id, Word.DENIED, "no_autopilot")]
        try:
            planned = plan(command, self.vehicle)
        except CannotExecute as refusal:
            return [Said(command_id, Word.DENIED, str(refusal))]
        out: list[Output] = []
        for older in [run for run in self._runs if run.phase is Phase.WAITING]:
            if older.plan.group is planned.group:
                out.append(self._end(older, Word.SUPERSEDED, by=command_id))
        run = Run(command_id, command, planned, deadline_ms, limit_ms)
        self._runs.append(run)
        return out + self._try_send(run, now_ms)

    def on_transmitted(self, command_id: CommandId, now_ms: int) -> list[Output]:
        """The write happened; the clock read `now_ms` after it."""
        run = self._find(command_id)
        if run is None:
            return []
        if now_ms > run.deadline_ms:
            run.late_ms = max(run.late_ms or 0, now_ms - run.deadline_ms)
        return []

    def on_refused(self, command_id: CommandId, late: bool, now_ms: int) -> list[Output]:
        """The runner did not write: past the deadline (`late`), or the autopilot's link took nothing."""
        run = self._find(command_id)
        if run is None or run.phase is not Phase.SENT:
            return []
        run.sends -= 1
        if run.sends > 0:
            return []
        run.phase = Phase.WAITING
        return [self._end(run, Word.EXPIRED)] if late else []

    def on_message(self, message: Any, now_ms: int) -> list[Output]:
        """A message of the autopilot, after `vehicle` has taken it in."""
        if message.get_type() == "COMMAND_ACK":
            return self._on_ack(message, now_ms)
        return self._observe(now_ms)

    def tick(self, now_ms: int) -> list[Output]:
        """Deadlines, retransmissions and limits; to be called at least ten times a second."""
        out: list[Output] = []
        for run in list(self._runs):
            if run.phase is Phase.WAITING:
                out += self._try_send(run, now_ms)
            elif run.phase is Phase.SENT:
                out += self._await_ack(run, now_ms)
            elif now_ms >= run.started_ms + run.limit_ms:
                alive = self.vehicle.is_alive(now_ms)
                word, reason = (Word.FAILED, "timeout") if alive else (Word.UNCONFIRMED, "autopilot_lost")
                out.append(self._end(run, word, reason))
        return out + self._observe(now_ms)

    def _find(self, command_id: CommandId) -> Run | None:
        return next((run for run in self._runs if run.id == command_id), None)

    def _end(self, run: Run, word: Word, reason: str | None = None, by: CommandId | None = None) -> Said:
        self._runs.remove(run)
        return Said(run.id, word, reason, late_ms=run.late_ms, by=by)

    def _is_free(self, mav_cmd: int, now_ms: int) -> bool:
        if any(run.phase is Phase.SENT and run.plan.mav_cmd == mav_cmd for run in self._runs):
            return False
        return now_ms >= self._barred_until_ms.get(mav_cmd, 0)

    def _try_send(self, run: Run, now_ms: int) -> list[Output]:
        if now_ms > run.deadline_ms:
            return [self._end(run, Word.EXPIRED)]
        if not self._is_free(run.plan.mav_cmd, now_ms):
            return []
        self._stray_acks.pop(run.plan.mav_cmd, None)
        run.phase = Phase.SENT
        run.started_ms = now_ms
        return self._send(run, now_ms)

    def _send(self, run: Run, now_ms: int) -> list[Output]:
        run.sends += 1
        run.last_send_ms = now_ms
        return [Transmit(run.plan.message, run.deadline_ms, run.id)]

    def _await_ack(self, run: Run, now_ms: int) -> list[Output]:
        if run.in_progress:
            if now_ms < run.started_ms + run.limit_ms:
                return []
        elif now_ms < run.last_send_ms + RESEND_MS:
            return []
        elif run.sends < SENDS and now_ms <= run.deadline_ms and self._newer(run) is None:
            return self._send(run, now_ms)
        elif now_ms < run.last_send_ms + 2 * RESEND_MS:
            return []
        self._bar(run, now_ms)
        return [self._end(run, Word.UNCONFIRMED, "no_ack")]

    def _bar(self, run: Run, now_ms: int) -> None:
        """Leave the number alone while acknowledgements of this run may still come."""
        self._barred_until_ms[run.plan.mav_cmd] = now_ms + STRAY_ACK_MS
        self._stray_acks[run.plan.mav_cmd] = run.sends - run.acks

    def _on_ack(self, message: Any, now_ms: int) -> list[Output]:
        run = next((r for r in self._runs if r.phase is Phase.SENT and r.plan.mav_cmd == message.command), None)
        if run is None:
            return self._on_stray_ack(message)
        if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
            run.in_progress = True
            return [Said(run.id, Word.IN_PROGRESS, percent=message.progress if message.progress <= 100 else None)]
        run.acks += 1
        if run.sends > run.acks:
            self._bar(run, now_ms)
        if message.result != mavlink.MAV_RESULT_ACCEPTED:
            word, reason = _RESULTS.get(message.result, (Word.FAILED, f"mav_result_{message.result}"))
            return [self._end(run, word, reason)]
        run.phase = Phase.RUNNING
        run.accepted_ms = now_ms
        run.accepted_number = self.vehicle.number
        out: list[Output] = [Said(run.id, Word.ACCEPTED, late_ms=run.late_ms)]
        for other in [r for r in self._runs if r is not run and r.phase is Phase.RUNNING]:
            if other.plan.group is run.plan.group and other is not self._newer(run):
                out.append(self._end(other, Word.SUPERSEDED, by=run.id))
        newer = self._newer(run)
        if newer is not None and newer.phase is Phase.RUNNING:
            out.append(self._end(run, Word.SUPERSEDED, by=newer.id))
        return out

    def _newer(self, run: Run) -> Run | None:
        """A later command of the same group that was sent too: the older one must not be said again after it."""
        later = self._runs[self._runs.index(run) + 1 :]
        return next((r for r in later if r.plan.group is run.plan.group and r.phase is not Phase.WAITING), None)

    def _on_stray_ack(self, message: Any) -> list[Output]:
        left = self._stray_acks.get(message.command)
        if left is None:
            if message.command not in _FLIGHT_COMMANDS:
                return []
            return [Log("ack_unexpected", f"COMMAND_ACK of {message.command} without an open command")]
        self._stray_acks[message.command] = left - 1
        if left <= 1:
            del self._stray_acks[message.command]
            self._barred_until_ms.pop(message.command, None)
        return [Log("ack_discarded", f"late COMMAND_ACK of {message.command}")]

    def _observe(self, now_ms: int) -> list[Output]:
        out: list[Output] = []
        for run in [run for run in self._runs if run.phase is Phase.RUNNING]:
            if run.plan.effect(self.vehicle, run.accepted_number):
                out.append(self._end(run, Word.COMPLETED))
                continue
            reason = self._interrupted(run, now_ms)
            if reason is not None:
                out.append(self._end(run, Word.FAILED, reason))
        return out

    def _interrupted(self, run: Run, now_ms: int) -> str | None:
        """Why a running command can no longer have its effect, None while it can."""
        if run.plan.modes is None or any(
            other.phase is Phase.SENT and other.plan.group is run.plan.group for other in self._runs
        ):
            return None
        armed = self.vehicle.seen(Armed, run.accepted_number)
        if isinstance(run.command, Takeoff | Goto) and armed == Armed(False):
            return "disarmed"
        told = self.vehicle.seen(FlightMode, run.accepted_number)
        if told is None:
            return None
        if told.mode in run.plan.modes:
            run.entered_mode = True
            run.passing_since_ms = None
            return None
        if run.entered_mode and told.mode not in run.plan.passing:
            return "mode_changed"
        if run.passing_since_ms is None:
            run.passing_since_ms = now_ms
        return "mode_changed" if now_ms - run.passing_since_ms > MODE_GRACE_MS else None
