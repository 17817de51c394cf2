"""Executes commands on one autopilot over MAVLink, each within its deadline and to its one last word.

COMMAND_ACK carries only the command's number and the component that it answers. So at most one command of a MAV_CMD is
open per sender component, and a number whose acknowledgement may still be under way rests until that arrives or three
seconds have passed. Hold and pause never wait: they use a component that no other open command uses, if one is free.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..core.ledger import OVERRIDING
from ..protocol.commands import (
    Arm,
    ClearPlan,
    Command,
    Hold,
    Mavlink,
    Offboard,
    Pause,
    Resume,
    SetCurrentItem,
    SetParameter,
    StartMission,
    Stream,
    UploadPlan,
)
from ..protocol.messages import CommandId, Word
from ..protocol.parameters import ParameterSet
from ..protocol.states import FlightMode
from .acknowledgements import Acknowledgements
from .effects import Transmit
from .held_lease import HeldLease
from .interruptions import SETTLED_MS, interrupted, is_overridden, is_taken_over, modes_shown
from .logs.reader import LogReader
from .mavlink.plans import CannotExecute, Plan, check
from .mavlink.raw import Limits, plan_raw
from .mavlink.sources import HALTING, Source
from .mavlink.vehicle import Vehicle
from .offboard import OffboardPilot
from .parameter_copy import ParameterCopy
from .parameter_settings import ParameterSettings
from .plan_keeper import PlanKeeper
from .preparation import Preparer
from .runs import UNSENT, Output, Phase, Run, Runs, Said
from .streams import Streams
from .takeoffs import Takeoffs

SENDS = 4
RESEND_MS = 500
"""MAVLink's command protocol: repeated until acknowledged; the counts are MAVSDK's."""
IN_THE_AIR: int = mavlink.MAV_CMD_DO_REPOSITION
"""What a hold is in the air."""
ONCE_MS = 3000
"""How long a command that is never repeated may stay without an acknowledgement."""


class Executor:
    """The commands of one autopilot. Every method returns effects and words, in their order."""

    def __init__(
        self,
        vehicle: Vehicle,
        limits: Limits | None = None,
        staged: Callable[[bytes], bytes | None] = lambda _: None,
        kept_parameters: ParameterSet | None = None,
    ) -> None:
        self.vehicle = vehicle
        self._runs = Runs()
        self.plans = PlanKeeper(vehicle, staged, self._runs.has_mission)
        self.parameters = ParameterCopy(vehicle, kept_parameters)
        self.logs = LogReader(vehicle)
        self._limits = limits or Limits()
        self._settings = ParameterSettings(vehicle, self._limits)
        self.lease = HeldLease()
        self._pilot = OffboardPilot(vehicle, self._runs, self.lease)
        self._acknowledgements = Acknowledgements(vehicle, self._runs, self._pilot)
        self._preparer = Preparer(vehicle, self._runs)
        self._takeoffs = Takeoffs(vehicle, self._runs)
        self.streams = Streams(vehicle)
        self.is_leaving = False

    def start(
        self, command_id: CommandId, command: Command, deadline_ms: int, limit_ms: int, now_ms: int
    ) -> list[Output]:
        """Begin an admitted command; its first write may have to wait until its MAV_CMD is free."""
        out = self.logs.give_way(now_ms)
        reason = self._pilot.refusal(command_id.gs_session, now_ms) if isinstance(command, Offboard) else None
        if reason is not None:
            return [*out, Said(command_id, Word.DENIED, reason)]
        if now_ms > deadline_ms:
            return [*out, Said(command_id, Word.EXPIRED)]
        if isinstance(command, UploadPlan | ClearPlan | SetCurrentItem):
            return out + self.plans.start(command_id, command, deadline_ms, limit_ms, now_ms)
        if isinstance(command, SetParameter):
            return out + self._settings.start(command_id, command, deadline_ms, limit_ms, now_ms)
        try:
            planned = self._plan(command, now_ms)
        except CannotExecute as error:
            return [*out, Said(command_id, Word.DENIED, str(error))]
        run = Run(command_id, command, planned, deadline_ms, limit_ms)
        run.begun_number, run.begun_modes = self.vehicle.number, modes_shown(self.vehicle)
        self._runs.add(run)
        for older in self._runs.older(run):
            older.is_outdated = True
            if older.phase in UNSENT:
                out.append(self._runs.end(older, Word.SUPERSEDED, by=command_id))
        return out + self._go_on(run, now_ms) + self._pilot.set_points(now_ms)

    def on_transmitted(self, command_id: CommandId, now_ms: int) -> list[Output]:
        """The command was written; the clock read `now_ms` after it. The wait for its acknowledgement begins."""
        run = self._runs.find(command_id)
        if self.plans.owns(command_id):
            if run is not None:
                run.has_set_item = True
            return self.plans.on_transmitted(command_id, now_ms)
        if self._settings.owns(command_id):
            return self._settings.on_transmitted(command_id, now_ms)
        if run is None:
            return []
        run.last_send_ms = now_ms
        if now_ms > run.deadline_ms:
            run.late_ms = max(run.late_ms or 0, now_ms - run.deadline_ms)
        return []

    def on_refused(self, command_id: CommandId, late: bool, now_ms: int) -> list[Output]:
        """The runner did not write: past the deadline (`late`), or because the autopilot's link refused it."""
        if self.plans.owns(command_id):
            return self.plans.on_refused(command_id, late, now_ms)
        if self._settings.owns(command_id):
            return self._settings.on_refused(command_id, late, now_ms)
        run = self._runs.find(command_id)
        if run is None or run.phase is not Phase.SENT:
            return []
        run.sends -= 1
        if run.sends > 0:
            return []
        run.phase = Phase.WAITING
        return [self._runs.end(run, Word.EXPIRED)] if late else []

    def on_message(self, message: Any, now_ms: int) -> list[Output]:
        """A message of the autopilot, after `vehicle` was updated by it."""
        if message.get_type() == "COMMAND_ACK":
            return self._acknowledgements.on_ack(message, now_ms)
        out = self.plans.on_message(message, now_ms) + self._settings.on_message(message, now_ms)
        out += self.parameters.on_message(message, now_ms) + self.logs.on_message(message, now_ms)
        out += self._acknowledgements.explained(now_ms)
        return out + self._observe(now_ms) + self._undo(now_ms)

    def tick(self, now_ms: int) -> list[Output]:
        """Deadlines, retransmissions and limits. Call it at least ten times per second."""
        self._runs.now_ms = now_ms
        out = self._acknowledgements.explained(now_ms)
        out += self._settings.tick(now_ms) + self.parameters.tick(now_ms) + self.logs.tick(now_ms)
        for run in self._runs:
            if run.phase in UNSENT:
                out += self._try_send(run, now_ms) if not self.is_leaving else []
            elif run.phase is Phase.SENT:
                out += self._acknowledgements.tell_progress(run, now_ms) + self._await_ack(run, now_ms)
            elif run.phase is Phase.STOPPING:
                out += self._pilot.go_on_stopping(run, now_ms)
            elif isinstance(run.command, Offboard):
                over = self._pilot.over(run, now_ms)
                out += self._pilot.stop(run, *over, now_ms) if over is not None else []
            elif now_ms >= run.started_ms + run.limit_ms:
                out.append(self._time_out(run, now_ms))
        out += self.plans.tick(now_ms, [run.id for run in self._runs])  # last: starts may have ended above
        return out + self._observe(now_ms) + self._undo(now_ms) + self._pilot.set_points(now_ms)

    def _undo(self, now_ms: int) -> list[Output]:
        return self._takeoffs.undo(now_ms) if not self._pilot.is_unsure else []

    def ask(self, message: Any, now_ms: int) -> list[Output]:
        """Write the client's own request, unless a command waits for an acknowledgement of the same number."""
        if message.get_type() == "COMMAND_LONG":
            if self._runs.awaiting((message.command, Source.COMPANION)) is not None:
                return []
            self._runs.acks.expect((message.command, Source.COMPANION), now_ms)
        return [Transmit(message)]

    def stood_still(self) -> None:
        """The process stood still: a pilot may have taken over, and acknowledgements are lost.

        Nothing is repeated, and only a hold, land or return is begun, until a fresh heartbeat shows the mode.
        """
        self._pilot.unsure_after = self.vehicle.number
        for run in self._runs:
            run.is_outdated = run.is_outdated or run.phase is Phase.SENT

    def leave(self, now_ms: int) -> list[Output]:
        """Before the process ends, begin nothing more, and stop what must not go on without it: offboard commands."""
        self.is_leaving = True
        return self._pilot.leave(now_ms)

    def _plan(self, command: Command, now_ms: int) -> Plan:
        """A command's MAVLink message and effect. Raises CannotExecute if the autopilot's last state forbids it."""
        is_there = self.vehicle.is_heard if isinstance(command, OVERRIDING) else self.vehicle.is_alive
        if not is_there(now_ms):
            raise CannotExecute("no_autopilot")
        if isinstance(command, Stream):
            return self.streams.plan(command, now_ms)
        if isinstance(command, Mavlink):
            return plan_raw(command, self.vehicle, self._limits)
        if isinstance(command, Pause) and self._runs.has_mission():  # heartbeats may not show the mission yet
            command = Hold()
        check(command, self.vehicle, now_ms)
        return self.vehicle.autopilot.plan(command, self.vehicle, now_ms)

    def _time_out(self, run: Run, now_ms: int) -> Said:
        if not self.vehicle.is_alive(now_ms) or not self.vehicle.boots.is_sure:
            return self._give_up(run, Word.UNCONFIRMED, "autopilot_lost", now_ms)
        if run.phase is Phase.SENT and run.refused is not None:
            return self._give_up(run, Word.UNCONFIRMED, "refused_once", now_ms)
        return self._give_up(run, Word.FAILED, "timeout", now_ms)

    def _give_up(self, run: Run, word: Word, reason: str, now_ms: int) -> Said:
        """End a command that is under way without its effect."""
        if isinstance(run.command, Stream):
            self.streams.drop(run.command.state)
        if run.phase is Phase.SENT:
            self._acknowledgements.rest(run, now_ms)
        return self._runs.end(run, word, reason)

    def _try_send(self, run: Run, now_ms: int) -> list[Output]:
        if now_ms > run.deadline_ms:
            return [self._runs.end(run, Word.EXPIRED)]
        try:
            run.plan = self._plan(run.command, now_ms)  # the autopilot's state may have changed
        except CannotExecute as error:
            return [self._runs.end(run, Word.DENIED, str(error))]
        return self._go_on(run, now_ms)

    def _go_on(self, run: Run, now_ms: int) -> list[Output]:
        """The next step of a command that is not sent yet and was planned just now."""
        if self._preparer.is_taken_over(run):
            return [self._runs.end(run, Word.FAILED, "mode_changed")]
        if run.preparation is None and is_overridden(run, self._runs, self.vehicle):
            return [self._runs.end(run, Word.DENIED, "mode_changed")]
        if self._pilot.is_unsure and not isinstance(run.command, OVERRIDING):
            return []
        if run.phase is Phase.WAITING:
            run.started_ms = now_ms
        if run.plan.message is None:
            return self._begin_unsaid(run, now_ms)
        first = run.plan.first_mode
        if first is not None and self.vehicle.seen(FlightMode) != FlightMode(first):
            return self._preparer.prepare(run, first, now_ms)
        if isinstance(run.command, StartMission | Resume):
            reason = self.plans.preparing(run.id, run.command, run.deadline_ms)
            if reason is not None:
                return [self._runs.end(run, Word.DENIED, reason)] if reason else []
        if isinstance(run.command, Offboard) and self._pilot.needs_priming(run):
            run.phase = Phase.PRIMING
            self._pilot.begin(run, now_ms)
            if not self._pilot.is_primed(run):
                return []
        halts = isinstance(run.command, Hold | Pause)
        sources = HALTING if halts else (Source.COMPANION,)
        free = next((one for one in sources if self._runs.is_free((run.plan.mav_cmd, one), now_ms)), None)
        if free is None and not halts:
            return []
        run.source = free or sources[-1]
        if free is not None:
            self._runs.acks.begin(run.ack_key)
        run.phase = Phase.SENT
        return self._send(run, now_ms)

    def _begin_unsaid(self, run: Run, now_ms: int) -> list[Output]:
        """Run a command that needs no write, once no older one of its group awaits an acknowledgement."""
        if any(older.phase is Phase.SENT for older in self._runs.older(run)):
            return []
        _, *superseded = self._acknowledgements.accept(run, now_ms)
        return superseded

    def _send(self, run: Run, now_ms: int) -> list[Output]:
        if run.sends == 0:
            run.first_number, run.first_ms = self.vehicle.number, now_ms
        run.sends += 1
        run.was_written = True
        run.last_send_ms, run.sent_number = now_ms, self.vehicle.number
        run.modes_before |= modes_shown(self.vehicle) | self._runs.own_modes(besides=run)
        self._takeoffs.said(run.command, now_ms)
        return [Transmit(run.plan.message, run.deadline_ms, run.id, run.source)]

    def _await_ack(self, run: Run, now_ms: int) -> list[Output]:
        if run.in_progress:
            return [self._time_out(run, now_ms)] if now_ms >= run.started_ms + run.limit_ms else []
        is_taken = is_taken_over(run, self.vehicle)
        if is_taken and run.entered_mode and isinstance(run.command, Offboard):
            self._acknowledgements.rest(run, now_ms)
            return [self._runs.end(run, Word.FAILED, "mode_changed")]
        run.is_outdated = run.is_outdated or is_taken
        if now_ms < run.last_send_ms + (ONCE_MS if run.plan.is_said_once else RESEND_MS):
            return []
        if run.has_shown and run.refused is None:  # a copy could undo what a pilot did since
            self._acknowledgements.rest(run, now_ms)
            if not run.plan.effect(self.vehicle, run.first_number):
                return [self._runs.end(run, Word.UNCONFIRMED, "no_ack")]
            out = self._acknowledgements.accept(run, now_ms)
            return [*out, self._runs.end(run, Word.COMPLETED)] if self._runs.find(run.id) is run else out
        if (
            run.refused is None
            and not run.plan.is_said_once
            and run.sends + run.earlier_sends < SENDS
            and now_ms <= run.deadline_ms
            and not run.is_outdated
            and self._may_repeat(run, now_ms)
        ):
            return self._send(run, now_ms)
        if not run.is_outdated and self._has_other_form(run, now_ms):
            self._acknowledgements.rest(run, now_ms)
            run.phase, run.earlier_sends, run.sends, run.acks, run.refusals = Phase.WAITING, run.sends, 0, 0, 0
            return self._try_send(run, now_ms)
        if now_ms < run.last_send_ms + 2 * RESEND_MS:
            return []
        self._acknowledgements.rest(run, now_ms)
        reason = "no_ack" if run.refused is None else "refused_once"
        if isinstance(run.command, Offboard):
            return self._pilot.stop(run, Word.UNCONFIRMED, reason, now_ms)
        return [self._runs.end(run, Word.UNCONFIRMED, reason)]

    def _may_repeat(self, run: Run, now_ms: int) -> bool:
        """Whether the conditions of the first write still hold."""
        try:
            planned = self._plan(run.command, now_ms)
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
            planned = self._plan(run.command, now_ms)
        except CannotExecute:
            return False
        return planned.mav_cmd == IN_THE_AIR != run.plan.mav_cmd

    def _observe(self, now_ms: int) -> list[Output]:
        out: list[Output] = []
        for run in self._runs:
            if run.phase is Phase.STOPPING:
                out += self._pilot.go_on_stopping(run, now_ms)
            elif isinstance(run.command, Offboard):
                out += self._observe_offboard(run, now_ms)
            elif run.is_under_way:
                out += self._observe_run(run, now_ms)
            elif run.phase is Phase.SENT and isinstance(run.command, Arm) and self.vehicle.boots.is_sure:
                if now_ms < run.first_ms + SETTLED_MS:  # a heartbeat of before the write may still arrive
                    run.first_number = self.vehicle.number
                run.has_shown = run.has_shown or run.plan.effect(self.vehicle, run.first_number)
        return out

    def _observe_offboard(self, run: Run, now_ms: int) -> list[Output]:
        reason = interrupted(run, self._runs, self.vehicle, now_ms) if run.phase is Phase.RUNNING else None
        if reason == "disarmed":
            return self._pilot.stop(run, Word.FAILED, reason, now_ms)
        return [self._runs.end(run, Word.FAILED, reason)] if reason is not None else []

    def _observe_run(self, run: Run, now_ms: int) -> list[Output]:
        """The last word if the effect was observed, or cannot be any more, as after the autopilot's restart."""
        lost = "autopilot_restarted" if self.vehicle.boots.restarts != run.restarts else None
        lost = lost or ("autopilot_lost" if self.vehicle.is_lost(now_ms) else None)
        if lost is not None:
            return [self._give_up(run, Word.UNCONFIRMED, lost, now_ms)]
        if run.phase is not Phase.RUNNING or not self.vehicle.boots.is_sure:
            return []
        if run.plan.effect(self.vehicle, run.accepted_number):
            return [self._runs.end(run, Word.COMPLETED)]
        reason = interrupted(run, self._runs, self.vehicle, now_ms)
        return [self._runs.end(run, Word.FAILED, reason)] if reason is not None else []
