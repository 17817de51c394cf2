"""What a ground station learns: outcomes of its commands, states of drones, and who is reachable."""

from __future__ import annotations

from dataclasses import dataclass

from .messages import CommandId, Word
from .states import State


@dataclass(frozen=True)
class Outcome:
    """One word about a command and a drone. `drone` None: about the fog as a whole.

    `is_last` marks a drone's one last word; `settled` the truth that followed an `unconfirmed`. `late_ms`:
    how far past its deadline the drone's clock read after the write. `age_ms` is an upper bound of how long
    ago it was said, None where the fog has no clock of it.
    """

    id: CommandId
    fog: int
    drone: int | None
    command: str
    word: Word
    reason: str | None = None
    percent: int | None = None
    late_ms: int | None = None
    superseded_by: CommandId | None = None
    settled: bool = False
    age_ms: int | None = None

    @property
    def is_last(self) -> bool:
        return self.word.is_last and not self.settled

    def __str__(self) -> str:
        who = f"fog {self.fog}" if self.drone is None else f"drone {self.drone}"
        what = f"{self.word.label}({self.reason})" if self.reason else self.word.label
        if self.superseded_by is not None:
            what = f"{self.word.label}(by {self.superseded_by})"
        if self.percent is not None:
            what += f" {self.percent} %"
        late = f", {self.late_ms} ms late" if self.late_ms else ""
        return f"{who}: {self.command} {'settled as ' if self.settled else ''}{what}{late}"


@dataclass(frozen=True)
class StateUpdate:
    """A state of a drone; `age_ms` is an upper bound of its age when it arrived."""

    fog: int
    drone: int
    state: State
    stamp: int
    age_ms: int | None


@dataclass(frozen=True)
class Reachability:
    """A fog (`drone` None) or a drone has become reachable or unreachable."""

    fog: int
    drone: int | None
    reachable: bool


Event = Outcome | StateUpdate | Reachability
