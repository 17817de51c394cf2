"""The commands about a drone's plan, and the preparation of a mission's start (docs/protocol.md, section 16)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ..errors import PayloadError
from ..protocol.commands import ClearPlan, Resume, SetCurrentItem, StartMission, UploadPlan
from ..protocol.messages import CommandId, Word
from ..protocol.plans import PlanItem, PlanList, PlanObject
from ..protocol.states import Armed, FlightMode, FlightModeName
from ..protocol.words import NOT_IN_CONTROL
from .effects import Transmit
from .mavlink.mission_protocol import Exchange, ExchangeFailed, Step, Steps
from .mavlink.plans import CannotExecute
from .mavlink.sources import Source
from .mavlink.vehicle import Vehicle
from .plan_lists import OtherPlan, PlanLists, check_nulls
from .runs import Output, Runs, Said
from .write_permit import WritePermit

OfPlan = UploadPlan | ClearPlan | SetCurrentItem
MISSION_RUNNING = "mission_running"
SURE_MS = 1000
"""How long a plan that was read is given out: a waiting station takes it at once, a later one has it read anew."""


@dataclass(eq=False)
class _Job:
    """A transfer with the autopilot for the command `id`; None: for a station that fetches the plan.

    `is_begun`: a write may have changed the autopilot's lists or its current item. `is_outdated`: the current item is
    not written again, because the process stood still.
    """

    exchange: Exchange
    id: CommandId | None
    changes_lists: bool = False
    deadline_ms: int = 0
    ends_ms: int = 0
    restarts: int = 0
    is_begun: bool = False
    is_outdated: bool = False
    late_ms: int | None = None

    @property
    def is_preparation(self) -> bool:
        """Whether it is part of a mission's start, whose run gives the words."""
        return self.id is not None and self.ends_ms == 0


class PlanKeeper:
    """The plan of one drone: one transfer at a time, in the order of the requests.

    `staged` gives a staged object by its hash; `runs` has the open starts of missions; `permit` lets it write.
    """

    def __init__(
        self, vehicle: Vehicle, staged: Callable[[bytes], bytes | None], runs: Runs, permit: WritePermit
    ) -> None:
        self._vehicle = vehicle
        self._runs = runs
        self._permit = permit
        self._lists = PlanLists(vehicle)
        self._staged = staged
        self._jobs: list[_Job] = []
        self._fetched: tuple[bytes | str, int] | None = None
        """The whole plan as it was read last, or the reason of the failure, and when; kept until it is fetched."""
        self._restarts = vehicle.boots.restarts

    def start(
        self, command_id: CommandId, command: OfPlan, deadline_ms: int, limit_ms: int, now_ms: int
    ) -> list[Output]:
        """Begin an admitted command about the plan."""
        try:
            if not self._vehicle.is_alive(now_ms):
                raise CannotExecute("no_autopilot")
            exchange = Exchange(self._steps(command))
        except (CannotExecute, PayloadError) as error:
            return [Said(command_id, Word.DENIED, str(error))]
        changes_lists = not isinstance(command, SetCurrentItem)
        job = _Job(exchange, command_id, changes_lists, deadline_ms, now_ms + limit_ms, self._vehicle.boots.restarts)
        self._jobs.append(job)
        return self._begin_next(now_ms)

    def preparing(self, command_id: CommandId, command: StartMission | Resume, deadline_ms: int) -> str | None:
        """Prepare a mission's start: None once it may start, empty while unknown, otherwise why it may not.

        The list is read anew for each start, because another station may have uploaded one unnoticed.
        """
        job = next((job for job in self._jobs if job.id == command_id), None)
        if job is None:
            if any(job.changes_lists for job in self._jobs):
                return "plan_busy"
            item = command.item if isinstance(command, StartMission) else None
            steps = self._lists.select(command.mission, item)
            restarts = self._vehicle.boots.restarts
            self._jobs.append(_Job(Exchange(steps), command_id, deadline_ms=deadline_ms, restarts=restarts))
            return ""
        if not job.exchange.is_over:
            return ""
        self._jobs.remove(job)
        if job.restarts != self._vehicle.boots.restarts:
            return "autopilot_restarted"
        if job.exchange.error is not None:
            return str(job.exchange.error)
        if isinstance(command, StartMission):
            self._vehicle.mission.begin()
        return None

    def fetch(self, now_ms: int, known: bytes | None = None) -> bytes | str | None:
        """The whole plan, packed, or the reason of a failure; None while it is read. `known` makes no difference."""
        if not self._vehicle.is_alive(now_ms):
            return "no_autopilot"
        found, self._fetched = self._fetched, None
        if found is not None and now_ms - found[1] <= SURE_MS:
            return found[0]
        if not any(job.id is None for job in self._jobs):
            self._jobs.append(_Job(Exchange(self._lists.fetch_all()), None, restarts=self._vehicle.boots.restarts))
        return None

    def on_message(self, message: object, now_ms: int) -> list[Output]:
        """A message of the autopilot, after `vehicle` was updated by it."""
        self._notice_restart()
        self._drop_ended_starts()
        job = self._jobs[0] if self._jobs else None
        if job is None or not self._vehicle.is_own(message) or not self._is_for_us(message):
            return []
        return self._write(job, job.exchange.on_message(message, now_ms), now_ms)

    def tick(self, now_ms: int) -> list[Output]:
        """Repetitions, limits, and the autopilot's loss."""
        self._notice_restart()
        self._drop_ended_starts()
        out = self._begin_next(now_ms)
        job = self._jobs[0] if self._jobs else None
        if job is None or job.exchange.is_over:
            return out
        lost = "autopilot_restarted" if job.restarts != self._vehicle.boots.restarts else None
        lost = lost or ("autopilot_lost" if self._vehicle.is_lost(now_ms) else None)
        if lost is not None:
            return out + self._end(job, now_ms, Word.UNCONFIRMED if job.is_begun else Word.DENIED, lost)
        if job.ends_ms and now_ms >= job.ends_ms:
            is_partial = job.is_begun and job.changes_lists
            return out + self._end(job, now_ms, Word.FAILED, "partial, timeout" if is_partial else "timeout")
        return out + self._write(job, job.exchange.tick(now_ms), now_ms)

    def _drop_ended_starts(self) -> None:
        """Drop the preparations of starts that have their last word: another command may have superseded them."""
        self._jobs = [
            job for job in self._jobs if job.id is None or not job.is_preparation or self._runs.find(job.id) is not None
        ]

    def stood_still(self) -> None:
        """The process stood still: the item that was made the current one may have been changed by a pilot since."""
        for job in self._jobs:
            job.is_outdated = job.is_begun

    def owns(self, command_id: CommandId) -> bool:
        """Whether a write was for a command about the plan."""
        return any(job.id == command_id for job in self._jobs)

    def on_transmitted(self, command_id: CommandId, now_ms: int) -> list[Output]:
        """A write bound by the deadline was done. The first gives `in_progress`, except in a preparation."""
        job = next(job for job in self._jobs if job.id == command_id)
        if now_ms > job.deadline_ms:
            job.late_ms = max(job.late_ms or 0, now_ms - job.deadline_ms)
        was_begun, job.is_begun = job.is_begun, True
        if was_begun or job.is_preparation:
            return []
        return [Said(command_id, Word.IN_PROGRESS, late_ms=job.late_ms)]

    def on_refused(self, command_id: CommandId, late: bool, now_ms: int) -> list[Output]:
        """It was not written: past the deadline (`late`), or because the autopilot's link refused it."""
        job = next(job for job in self._jobs if job.id == command_id)
        return self._end(job, now_ms, Word.EXPIRED) if late and not job.is_begun else []

    def _steps(self, command: OfPlan) -> Steps[None]:
        """The steps of a command. Raises CannotExecute or PayloadError if it cannot be begun."""
        if isinstance(command, SetCurrentItem):
            return self._lists.select(command.mission, command.item)
        if any(job.changes_lists for job in self._jobs):
            raise CannotExecute("plan_busy")
        if isinstance(command, ClearPlan):
            return self._lists.replace(dict.fromkeys(PlanList, ()))
        data = self._staged(command.plan)
        if data is None:
            raise CannotExecute("not_staged")
        lists = PlanObject.unpacked(data).lists
        check_nulls(lists)
        return self._lists.replace(lists)

    def _begin_next(self, now_ms: int) -> list[Output]:
        """Begin the first job, after the end of commands that may not be written any more: a new holder's may wait."""
        out: list[Output] = []
        while self._jobs and not self._jobs[0].exchange.has_begun and not self._permit.is_leaving:
            job = self._jobs[0]
            is_late = now_ms > job.deadline_ms
            if job.id is None or job.is_preparation or (not is_late and self._permit.has_control(job.id)):
                return out + self._write(job, job.exchange.begin(now_ms), now_ms)
            word, reason = (Word.EXPIRED, None) if is_late else (Word.DENIED, NOT_IN_CONTROL)
            out += self._end(job, now_ms, word, reason)
        return out

    def _write(self, job: _Job, steps: list[Step], now_ms: int) -> list[Output]:
        """Write steps. The first that may change lists is bound by the deadline, and denied while a mission runs.

        Each write of the current item is so bound: it changes where the drone flies to.
        """
        out: list[Output] = []
        for step in steps:
            is_bound = step.changes and job.id is not None and not (job.changes_lists and job.is_begun)
            if is_bound and (job.is_outdated or self._permit.is_unsure()):
                continue
            if is_bound and job.changes_lists and self._is_flying_mission():
                return [*out, *self._end(job, now_ms, Word.DENIED, MISSION_RUNNING)]
            if is_bound and self._permit.is_leaving:
                return out
            if is_bound and job.id is not None and not self._permit.has_control(job.id):
                word = Word.UNCONFIRMED if job.is_begun else Word.DENIED
                return [*out, *self._end(job, now_ms, word, NOT_IN_CONTROL)]
            out.append(Transmit(step.message, job.deadline_ms, job.id) if is_bound else Transmit(step.message))
        return out + (self._over(job, now_ms) if job.exchange.is_over else [])

    def _over(self, job: _Job, now_ms: int) -> list[Output]:
        """The end of a transfer. The result of a preparation is left for its start's run."""
        error = job.exchange.error
        if job.id is None:
            self._jobs.remove(job)
            self._fetched = str(error) if error is not None else _packed(job.exchange.result), now_ms
            return []
        if job.is_preparation:
            return []
        if error is None:
            return self._end(job, now_ms, Word.COMPLETED)
        if job.is_begun and not job.changes_lists:
            return self._end(job, now_ms, Word.UNCONFIRMED, "no_ack")
        is_no = isinstance(error, OtherPlan)
        return self._end(job, now_ms, Word.DENIED if is_no else Word.FAILED, str(error))

    def _end(self, job: _Job, now_ms: int, word: Word, reason: str | None = None) -> list[Output]:
        """End a job with its last word; the start's run gives that of a preparation."""
        job.exchange.stop()
        if job.is_preparation:
            job.exchange.error = job.exchange.error or ExchangeFailed(reason or word.label)
            return []
        self._jobs.remove(job)
        if job.id is None:
            self._fetched = reason or word.label, now_ms
            return []
        return [Said(job.id, word, reason, late_ms=job.late_ms)]

    def _is_flying_mission(self) -> bool:
        mode = self._vehicle.seen(FlightMode)
        is_flown = mode == FlightMode(FlightModeName.MISSION) and self._vehicle.seen(Armed) == Armed(True)
        return is_flown or self._runs.has_mission()

    def _is_for_us(self, message: object) -> bool:
        """Whether a message is addressed to the UAV client, or to all."""
        system, component = (getattr(message, f"target_{what}", 0) for what in ("system", "component"))
        return system in (0, self._vehicle.system_id) and component in (0, Source.COMPANION.component)

    def _notice_restart(self) -> None:
        """After a restart of the autopilot, forget the lists' hashes until they are read again."""
        if self._restarts != self._vehicle.boots.restarts:
            self._restarts = self._vehicle.boots.restarts
            self._vehicle.mission.forget()


def _packed(lists: Mapping[PlanList, tuple[PlanItem, ...]]) -> bytes | str:
    """The plan packed, or the reason why it cannot be."""
    try:
        return PlanObject.of(lists).packed()
    except PayloadError as error:
        return str(error)
