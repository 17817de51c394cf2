"""Writes commands to one autopilot: when, in the name of which component, and when again (docs/protocol.md, R5.6).

COMMAND_ACK carries only the command's number and the component that it answers. So at most one command of a MAV_CMD is
open per sender component, and a number whose acknowledgement may still be under way rests until that arrives or three
seconds have passed. A command that stops the drone never waits: it uses a component that no other open command of its
number uses, if one is free.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from ..core.ledger import OVERRIDING
from ..protocol.commands import (
    Command,
    Disarm,
    Hold,
    Land,
    Mavlink,
    Offboard,
    Pause,
    Resume,
    Return,
    StartMission,
    Stream,
)
from ..protocol.messages import Word
from ..protocol.states import FlightMode
from ..protocol.words import NOT_IN_CONTROL
from .acknowledgements import Acknowledgements
from .effects import Transmit
from .interruptions import is_overridden, is_taken_over, modes_shown
from .mavlink.plans import CannotExecute, CommandPlan, check
from .mavlink.raw import Limits, plan_raw
from .mavlink.sources import COMMANDING, HALTING, Source
from .mavlink.vehicle import Vehicle
from .offboard import OffboardPilot
from .plan_keeper import PlanKeeper
from .preparation import Preparer
from .runs import Output, Phase, Run, Runs, Said
from .streams import Streams
from .takeoffs import Takeoffs
from .write_permit import WritePermit

SENDS = 4
RESEND_MS = 500
"""MAVLink's command protocol: repeated until acknowledged; the counts are MAVSDK's."""
IN_THE_AIR: int = mavlink.MAV_CMD_DO_REPOSITION
"""What a hold is in the air."""
ONCE_MS = 3000
"""How long a command that is never repeated may stay without an acknowledgement."""


@dataclass(frozen=True)
class CommandWriter:
    """The writes of all open commands. Every method returns effects and words, in their order."""

    vehicle: Vehicle
    runs: Runs
    limits: Limits
    pilot: OffboardPilot
    acknowledgements: Acknowledgements
    preparer: Preparer
    takeoffs: Takeoffs
    plans: PlanKeeper
    streams: Streams
    permit: WritePermit

    def plan(self, command: Command, now_ms: int) -> CommandPlan:
        """A command's MAVLink message and effect. Raises CannotExecute if the autopilot's last state forbids it."""
        is_there = self.vehicle.is_heard if isinstance(command, OVERRIDING) else self.vehicle.is_alive
        if not is_there(now_ms):
            raise CannotExecute("no_autopilot")
        if isinstance(command, Stream):
            return self.streams.plan(command, now_ms)
        if isinstance(command, Mavlink):
            return plan_raw(command, self.vehicle, self.limits)
        if isinstance(command, Pause) and self.runs.has_mission():  # heartbeats may not show the mission yet
            command = Hold()
        check(command, self.vehicle, now_ms)
        return self.vehicle.autopilot.plan(command, self.vehicle, now_ms)

    def try_write(self, run: Run, now_ms: int) -> list[Output]:
        """Work out a command that is not sent yet anew, and go on with it; past its deadline it is `expired`."""
        if now_ms > run.deadline_ms:
            return [self.runs.end(run, Word.EXPIRED)]
        try:
            run.plan = self.plan(run.command, now_ms)  # the autopilot's state may have changed
        except CannotExecute as error:
            return [self.runs.end(run, Word.DENIED, str(error))]
        return self.go_on(run, now_ms)

    def go_on(self, run: Run, now_ms: int) -> list[Output]:
        """The next step of a command that is not sent yet and was planned just now."""
        reason = self._lost_control(run, now_ms)
        if reason is not None:
            return [self.runs.end(run, Word.DENIED, reason)]
        if self.preparer.is_taken_over(run):
            return [self.runs.end(run, Word.FAILED, "mode_changed")]
        if run.preparation is None and is_overridden(run, self.runs, self.vehicle):
            return [self.runs.end(run, Word.DENIED, "mode_changed")]
        if self.pilot.is_unsure and not isinstance(run.command, OVERRIDING):
            return []
        if run.phase is Phase.WAITING:
            run.started_ms = now_ms
        if run.plan.message is None:
            return self._begin_unsaid(run, now_ms)
        first = run.plan.first_mode
        if first is not None and self.vehicle.seen(FlightMode) != FlightMode(first):
            return self.preparer.prepare(run, first, now_ms)
        if isinstance(run.command, StartMission | Resume):
            reason = self.plans.preparing(run.id, run.command, run.deadline_ms)
            if reason is not None:
                return [self.runs.end(run, Word.DENIED, reason)] if reason else []
        if isinstance(run.command, Offboard) and self.pilot.needs_priming(run):
            run.phase = Phase.PRIMING
            self.pilot.begin(run, now_ms)
            if not self.pilot.is_primed(run):
                return []
        sources = _sources(run.command)
        free = next((one for one in sources if self.runs.is_free((run.plan.mav_cmd, one), now_ms)), None)
        if free is None and len(sources) == 1:
            return []
        run.source = free or sources[-1]
        if free is not None:
            self.runs.acks.begin(run.ack_key)
        run.phase = Phase.SENT
        return self._write(run, now_ms)

    def _lost_control(self, run: Run, now_ms: int) -> str | None:
        """Why a command is not written any more, though its station had control when it began."""
        if not self.permit.has_control(run.id):
            return NOT_IN_CONTROL
        return "no_lease" if isinstance(run.command, Offboard) and self.pilot.has_lost_lease(run, now_ms) else None

    def _begin_unsaid(self, run: Run, now_ms: int) -> list[Output]:
        """Run a command that needs no write, once no older one of its group awaits an acknowledgement."""
        if any(older.phase is Phase.SENT for older in self.runs.older(run)):
            return []
        _, *superseded = self.acknowledgements.accept(run, now_ms)
        return superseded

    def _write(self, run: Run, now_ms: int) -> list[Output]:
        if run.sends == 0:
            run.first_number, run.first_ms = self.vehicle.number, now_ms
        run.sends += 1
        run.last_send_ms, run.sent_number = now_ms, self.vehicle.number
        run.modes_before |= modes_shown(self.vehicle) | self.runs.own_modes(besides=run)
        self.takeoffs.said(run.command, now_ms)
        return [Transmit(run.plan.message, run.deadline_ms, run.id, run.source)]

    def await_ack(self, run: Run, now_ms: int) -> list[Output]:
        """Repeat a written command that has no acknowledgement, or end it where it must not be written again."""
        is_taken = is_taken_over(run, self.vehicle)
        if is_taken and run.entered_mode and isinstance(run.command, Offboard):
            self.acknowledgements.rest(run, now_ms)
            return [self.runs.end(run, Word.FAILED, "mode_changed")]
        lost = self._lost_control(run, now_ms)
        if lost is not None and isinstance(run.command, Offboard):
            self.acknowledgements.rest(run, now_ms)
            return self.pilot.stop(run, Word.FAILED, "lease_lost", now_ms)
        run.is_outdated = run.is_outdated or is_taken or lost is not None
        if run.in_progress:
            return self._await_end(run, now_ms)
        if now_ms < run.last_send_ms + (ONCE_MS if run.plan.is_said_once else RESEND_MS):
            return []
        if run.has_shown and run.refused is None:  # a copy could undo what a pilot did since
            self.acknowledgements.rest(run, now_ms)
            if not run.plan.effect(self.vehicle, run.first_number):
                return [self.runs.end(run, Word.UNCONFIRMED, "no_ack")]
            out = self.acknowledgements.accept(run, now_ms)
            return [*out, self.runs.end(run, Word.COMPLETED)] if self.runs.find(run.id) is run else out
        if (
            run.refused is None
            and not run.plan.is_said_once
            and run.sends + run.earlier_sends < SENDS
            and now_ms <= run.deadline_ms
            and not run.is_outdated
            and self._may_repeat(run, now_ms)
        ):
            return self._write(run, now_ms)
        if not run.is_outdated and self._has_other_form(run, now_ms):
            self.acknowledgements.rest(run, now_ms)
            run.phase, run.earlier_sends, run.sends, run.acks, run.refusals = Phase.WAITING, run.sends, 0, 0, 0
            return self.try_write(run, now_ms)
        if now_ms < run.last_send_ms + 2 * RESEND_MS:
            return []
        self.acknowledgements.rest(run, now_ms)
        reason = "no_ack" if run.refused is None else "refused_once"
        if isinstance(run.command, Offboard):
            return self.pilot.stop(run, Word.UNCONFIRMED, reason, now_ms)
        return [self.runs.end(run, Word.UNCONFIRMED, reason)]

    def _await_end(self, run: Run, now_ms: int) -> list[Output]:
        """End a command that is in progress at its limit."""
        if now_ms < run.started_ms + run.limit_ms:
            return []
        if isinstance(run.command, Offboard):
            self.acknowledgements.rest(run, now_ms)
            return self.pilot.stop(run, Word.FAILED, "timeout", now_ms)
        return [self.time_out(run, now_ms)]

    def _may_repeat(self, run: Run, now_ms: int) -> bool:
        """Whether the conditions of the first write still hold."""
        try:
            planned = self.plan(run.command, now_ms)
        except CannotExecute:
            return False
        is_ready = planned.first_mode is None or self.vehicle.seen(FlightMode) == FlightMode(planned.first_mode)
        return is_ready and planned.mav_cmd == run.plan.mav_cmd

    def _has_other_form(self, run: Run, now_ms: int) -> bool:
        """Whether an unanswered hold of the ground has to be written as that of the air."""
        is_over = run.refused is not None or now_ms > run.deadline_ms or run.sends + run.earlier_sends >= SENDS
        if is_over or not isinstance(run.command, Hold | Pause):
            return False
        try:
            planned = self.plan(run.command, now_ms)
        except CannotExecute:
            return False
        return planned.mav_cmd == IN_THE_AIR != run.plan.mav_cmd

    def time_out(self, run: Run, now_ms: int) -> Said:
        """End a command that is under way at its limit."""
        if not self.vehicle.is_alive(now_ms) or not self.vehicle.boots.is_sure:
            return self.give_up(run, Word.UNCONFIRMED, "autopilot_lost", now_ms)
        if run.phase is Phase.SENT and run.refused is not None:
            return self.give_up(run, Word.UNCONFIRMED, "refused_once", now_ms)
        return self.give_up(run, Word.FAILED, "timeout", now_ms)

    def give_up(self, run: Run, word: Word, reason: str, now_ms: int) -> Said:
        """End a command that is under way without its effect."""
        if isinstance(run.command, Stream):
            self.streams.drop(run.command.state)
        if run.phase is Phase.SENT:
            self.acknowledgements.rest(run, now_ms)
        return self.runs.end(run, word, reason)


def _sources(command: Command) -> tuple[Source, ...]:
    """The components that may write a command, the preferred one first; with more than one it never waits."""
    if isinstance(command, Hold | Pause):
        return HALTING
    return COMMANDING if isinstance(command, Land | Return | Disarm) else (Source.COMPANION,)
