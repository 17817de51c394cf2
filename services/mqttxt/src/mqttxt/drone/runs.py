"""The commands that have no last word yet: the phase of each, and which of them block or replace each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, auto

from ..protocol.commands import Command, Resume, StartMission
from ..protocol.messages import CommandId, Word
from ..protocol.states import FlightMode, FlightModeName
from .effects import Effect
from .mavlink.plans import CommandPlan
from .mavlink.sources import Source
from .resting_numbers import AckKey, Acks


@dataclass(frozen=True)
class Said:
    """A word about a command."""

    id: CommandId
    word: Word
    reason: str | None = None
    percent: int | None = None
    late_ms: int | None = None
    by: CommandId | None = None
    observed: bool | None = None


Output = Effect | Said
OWN_MODE_MS = 10_000
"""How long after a written command's end its modes may still show: heartbeats arrive once per second, or are lost."""


class Phase(Enum):
    """The phase of a command.

    WAITING for its MAV_CMD to be free; PREPARING: the autopilot is put into another mode before it is sent;
    PRIMING: set-points are streamed before it is sent; SENT and not acknowledged; RUNNING: accepted; STOPPING: being
    ended safely, with its last word known but not given.
    """

    WAITING = auto()
    PREPARING = auto()
    PRIMING = auto()
    SENT = auto()
    RUNNING = auto()
    STOPPING = auto()


UNSENT = (Phase.WAITING, Phase.PREPARING, Phase.PRIMING)


@dataclass
class Preparation:
    """A mode that is commanded before a command, and the answers to its writes so far.

    `before`, `number` and `since_ms`: the mode, the newest message and the time at the first write. `is_outdated`: the
    process stood still, and an answer may be lost.
    """

    mode: FlightModeName
    before: FlightMode | None
    number: int
    since_ms: int
    writes: int = 0
    accepted: int = 0
    refusals: int = 0
    is_entered: bool = False
    is_outdated: bool = False

    def on_answer(self, is_accepted: bool, is_second: bool) -> None:
        """Count an acknowledgement of a write; `is_second`: of one that was accepted before."""
        if is_accepted and not is_second:
            self.accepted += 1
        elif not is_accepted:
            self.refusals += 1
            self.accepted -= is_second

    @property
    def may_have_changed(self) -> bool:
        """Whether a write may have changed the autopilot's mode."""
        return self.writes > self.refusals


@dataclass(eq=False)
class Run:
    """A command that has no last word yet. `refused`: the answer to a refused copy, while others are unanswered.

    `begun_number`, `begun_modes`: the newest message and the autopilot's mode when the command was begun;
    `first_number`, `first_ms`: the newest message and the time at its first write. `refusals` counts the refused
    copies; `restarts` is the autopilot's restart count when it accepted. `modes_before`: the modes that the autopilot
    may have been in when it accepted. `settled_number`: the newest message once later heartbeats must show the new
    mode, None until then. `is_outdated`: it is not sent again, because a newer command of its group was started,
    somebody changed the mode, or the process stood still. `has_shown`: a heartbeat has shown an unacknowledged arm's
    effect. `has_set_item`: the mission's current item was set. `earlier_sends`: how often it was written in an earlier
    form, which is unanswered. `newer_modes`: the modes of the newest command that was begun after it and has any.
    """

    id: CommandId
    command: Command
    plan: CommandPlan
    deadline_ms: int
    limit_ms: int
    phase: Phase = Phase.WAITING
    begun_number: int = 0
    begun_modes: frozenset[FlightModeName] = frozenset()
    first_number: int = 0
    first_ms: int = 0
    sends: int = 0
    acks: int = 0
    refusals: int = 0
    last_send_ms: int = 0
    sent_number: int = 0
    started_ms: int = 0
    accepted_ms: int = 0
    accepted_number: int = 0
    restarts: int = 0
    in_progress: bool = False
    percent: int | None = None
    told_percent: int | None = None
    told_percent_ms: int = 0
    preparation: Preparation | None = None
    refused: tuple[Word, str | None] | None = None
    entered_mode: bool = False
    modes_before: frozenset[FlightModeName] = frozenset()
    settled_number: int | None = None
    passing_since_ms: int | None = None
    late_ms: int | None = None
    is_outdated: bool = False
    has_set_item: bool = False
    has_shown: bool = False
    earlier_sends: int = 0
    newer_modes: frozenset[FlightModeName] | None = None
    source: Source = Source.COMPANION

    @property
    def ack_key(self) -> AckKey:
        """The key of its acknowledgements."""
        return self.plan.mav_cmd, self.source

    def is_of_group(self, other: Run) -> bool:
        """Whether one of the two can supersede the other."""
        return self.plan.group is not None and self.plan.group == other.plan.group

    @property
    def own_modes(self) -> frozenset[FlightModeName]:
        """The modes that the autopilot may be in because of what was written for it."""
        own: set[FlightModeName] = set()
        if self.sends + self.earlier_sends > 0:
            own |= (self.plan.modes or frozenset()) | self.plan.passing
        if self.preparation is not None and self.preparation.writes > 0:
            own.add(self.preparation.mode)
        return frozenset(own)

    @property
    def may_have_changed(self) -> bool:
        """Whether its preparation may have changed something, so that a definite no would be false."""
        return self.has_set_item or (self.preparation is not None and self.preparation.may_have_changed)

    @property
    def is_under_way(self) -> bool:
        """Whether the autopilot has accepted it."""
        return self.phase in (Phase.RUNNING, Phase.STOPPING) or (self.phase is Phase.SENT and self.in_progress)


class Runs:
    """The open commands of one autopilot, oldest first, and the numbers that may be sent."""

    def __init__(self) -> None:
        self.acks = Acks()
        self.now_ms = 0
        self._runs: list[Run] = []
        self._ended: list[tuple[int, frozenset[FlightModeName]]] = []
        self._unsure_mission_ms = -math.inf
        """When the newest start of a mission ended that nobody knows of."""

    def __iter__(self) -> Iterator[Run]:
        """Iterate over a copy, so that a run may end meanwhile."""
        return iter(list(self._runs))

    def add(self, run: Run) -> None:
        self._runs.append(run)

    def find(self, command_id: CommandId) -> Run | None:
        return next((run for run in self._runs if run.id == command_id), None)

    def has_mission(self) -> bool:
        """Whether a mission's start is open, or was lately: the drone may fly it before a heartbeat shows that."""
        is_open = any(isinstance(run.command, StartMission | Resume) for run in self._runs)
        return is_open or self.now_ms - self._unsure_mission_ms <= OWN_MODE_MS

    def end(
        self,
        run: Run,
        word: Word,
        reason: str | None = None,
        by: CommandId | None = None,
        observed: bool | None = None,
    ) -> Said:
        """End a run with its last word; a definite no becomes `failed` if the autopilot may have changed."""
        self._runs.remove(run)
        if run.own_modes:
            self._ended.append((self.now_ms, run.own_modes))
        if word.is_definite_no and run.earlier_sends:
            word, reason = Word.UNCONFIRMED, "no_ack"
        if word.is_definite_no and run.may_have_changed:
            word, reason = Word.FAILED, reason or word.label
        if word is Word.UNCONFIRMED and isinstance(run.command, StartMission | Resume):
            self._unsure_mission_ms = self.now_ms
        return Said(run.id, word, reason, late_ms=run.late_ms, by=by, observed=observed)

    def own_modes(self, besides: Run) -> frozenset[FlightModeName]:
        """The modes of all other commands that are open, or ended within `OWN_MODE_MS`."""
        self._ended = [(at_ms, modes) for at_ms, modes in self._ended if self.now_ms - at_ms <= OWN_MODE_MS]
        written = [run.own_modes for run in self._runs if run is not besides]
        return frozenset[FlightModeName]().union(*written, *(modes for _, modes in self._ended))

    def awaiting(self, *keys: AckKey) -> Run | None:
        """The oldest run that waits for an acknowledgement of `keys`: they arrive in the order of the writes."""
        waiting = (run for run in self._runs if run.phase is Phase.SENT and run.ack_key in keys)
        return next((run for run in waiting if run.sends > run.acks), None)

    def sharing(self, keys: Sequence[AckKey]) -> list[Run]:
        """The runs that are sent under `keys` and not accepted.

        Several under one key only if commands that stop shared a component.
        """
        return [run for run in self._runs if run.phase is Phase.SENT and run.ack_key in keys]

    def is_free(self, key: AckKey, now_ms: int) -> bool:
        """Whether a key does not rest, and no run uses it: one that waits, or one that stops and repeats hold."""
        if any(run.phase in (Phase.SENT, Phase.STOPPING) and run.ack_key == key for run in self._runs):
            return False
        return self.acks.is_free(key, now_ms)

    def older(self, run: Run) -> list[Run]:
        """The earlier commands of the same group."""
        earlier = self._runs[: self._runs.index(run)]
        return [r for r in earlier if r.is_of_group(run)]

    def newer(self, run: Run) -> Run | None:
        """A later command of the same group that was sent: `run` must not be sent again after it."""
        later = self._runs[self._runs.index(run) + 1 :]
        return next((r for r in later if r.is_of_group(run) and r.phase not in UNSENT), None)
