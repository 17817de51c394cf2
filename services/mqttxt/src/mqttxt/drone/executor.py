"""Executes commands on one autopilot over MAVLink, each within its deadline and to its one last word."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..protocol.commands import (
    Arm,
    ClearPlan,
    Command,
    Offboard,
    SetCurrentItem,
    SetParameter,
    UploadPlan,
)
from ..protocol.messages import CommandId, Word
from ..protocol.parameters import ParameterSet
from .acknowledgements import Acknowledgements
from .command_writer import CommandWriter
from .effects import Transmit
from .held_lease import HeldLease
from .interruptions import SETTLED_MS, interrupted, modes_shown
from .logs.reader import LogReader
from .mavlink.plans import CannotExecute
from .mavlink.raw import Limits
from .mavlink.sources import Source
from .mavlink.vehicle import Vehicle
from .offboard import OffboardPilot
from .parameter_copy import ParameterCopy
from .parameter_settings import ParameterSettings
from .plan_keeper import PlanKeeper
from .preparation import Preparer
from .runs import UNSENT, Output, Phase, Run, Runs, Said
from .streams import Streams
from .takeoffs import Takeoffs
from .write_permit import WritePermit


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
        self.permit = WritePermit()
        self.plans = PlanKeeper(vehicle, staged, self._runs, self.permit)
        self.parameters = ParameterCopy(vehicle, kept_parameters)
        self.logs = LogReader(vehicle)
        limits = limits or Limits()
        self._settings = ParameterSettings(vehicle, limits, self.permit)
        self.lease = HeldLease()
        self._pilot = OffboardPilot(vehicle, self._runs, self.lease)
        self.permit.is_unsure = lambda: self._pilot.is_unsure
        self._acknowledgements = Acknowledgements(vehicle, self._runs, self._pilot)
        self._takeoffs = Takeoffs(vehicle, self._runs)
        self.streams = Streams(vehicle)
        self._writer = CommandWriter(
            vehicle=vehicle,
            runs=self._runs,
            limits=limits,
            pilot=self._pilot,
            acknowledgements=self._acknowledgements,
            preparer=Preparer(vehicle, self._runs),
            takeoffs=self._takeoffs,
            plans=self.plans,
            streams=self.streams,
            permit=self.permit,
        )

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
            planned = self._writer.plan(command, now_ms)
        except CannotExecute as error:
            return [*out, Said(command_id, Word.DENIED, str(error))]
        run = Run(command_id, command, planned, deadline_ms, limit_ms)
        run.begun_number, run.begun_modes = self.vehicle.number, modes_shown(self.vehicle)
        for earlier in self._runs:
            earlier.newer_modes = planned.modes or earlier.newer_modes
        self._runs.add(run)
        for older in self._runs.older(run):
            older.is_outdated = True
            if older.phase in UNSENT:
                out.append(self._runs.end(older, Word.SUPERSEDED, by=command_id))
        return out + self._writer.go_on(run, now_ms) + self._pilot.set_points(now_ms)

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
        self._takeoffs.unsaid(run.command)
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
                out += self._writer.try_write(run, now_ms) if not self.permit.is_leaving else []
            elif run.phase is Phase.SENT:
                out += self._acknowledgements.tell_progress(run, now_ms) + self._writer.await_ack(run, now_ms)
            elif run.phase is Phase.STOPPING:
                out += self._pilot.go_on_stopping(run, now_ms)
            elif isinstance(run.command, Offboard):
                over = self._pilot.over(run, now_ms)
                out += self._pilot.stop(run, *over, now_ms) if over is not None else []
            elif now_ms >= run.started_ms + run.limit_ms:
                out.append(self._writer.time_out(run, now_ms))
        out += self.plans.tick(now_ms)
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
            if run.preparation is not None:
                run.preparation.is_outdated = run.preparation.may_have_changed
        self.plans.stood_still()
        self._settings.stood_still()

    def leave(self, now_ms: int) -> list[Output]:
        """Before the process ends, begin nothing more, and stop what must not go on without it: offboard commands."""
        self.permit.is_leaving = True
        return [*self._acknowledgements.unexplained(), *self._pilot.leave(now_ms)]

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
            return [self._writer.give_up(run, Word.UNCONFIRMED, lost, now_ms)]
        if run.phase is not Phase.RUNNING or not self.vehicle.boots.is_sure:
            return []
        if run.plan.effect(self.vehicle, run.accepted_number):
            return [self._runs.end(run, Word.COMPLETED)]
        reason = interrupted(run, self._runs, self.vehicle, now_ms)
        return [self._runs.end(run, Word.FAILED, reason)] if reason is not None else []
