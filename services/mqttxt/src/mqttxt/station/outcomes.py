"""A ground station's events: outcomes of commands, states, reachability and control of drones, rankings, readings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

from ..core.printable import printable
from ..protocol.messages import CommandId, Word
from ..protocol.names import in_fleet
from ..protocol.rankings import Candidate, Ranked
from ..protocol.states import State
from ..protocol.words import PASSED_OVER


@dataclass(frozen=True)
class Outcome:
    """One word about a command and a drone.

    Parameters:
        id: the command's id: the station's session and the command's number in it.
        fog: the fog's number.
        drone: the drone's number; None: the word is about the fog as a whole.
        command: the command's name, as `takeoff`.
        word: the word.
        reason: the reason, in the specification's words or the autopilot's; None where there is none.
        percent: the progress, 0 to 100, with `in_progress`.
        late_ms: how far past its deadline the drone's clock read after the write, in milliseconds.
        superseded_by: the id of the command that superseded this one.
        settled: this is the real outcome after an `unconfirmed`, and no last word.
        age_ms: an upper bound of its age, in milliseconds; None where the fog's clock is not known. Too small by a
            multiple of 655,360 where it first arrived that long after it was published, or later.
        observed: false for a `completed` whose effect was not observed.
        signer: the node that signed it: `drone2`, or `fog1` for an activator's own word; None without signatures.
        fleet: the fleet's name, where the station is one of `Fleets`; else empty.
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
    observed: bool = True
    signer: str | None = None
    fleet: str = ""

    @property
    def is_last(self) -> bool:
        """Whether it is the drone's one last word; a word that settles an `unconfirmed` afterwards is none."""
        return self.word.is_last and not self.settled

    @property
    def completed(self) -> bool:
        """Whether the drone has done it; where `observed` is false, its effect was not observed."""
        return self.word is Word.COMPLETED

    @property
    def is_of_activator(self) -> bool:
        """Whether an activator has signed it, not the drone, whose own word may differ; false without signatures."""
        return self.signer is not None and self.signer != f"drone{self.drone}"

    def __str__(self) -> str:
        kind, number = ("fog", self.fog) if self.drone is None else ("drone", self.drone)
        who = f"{kind} {in_fleet(self.fleet, number)}"
        what = f"{self.word.label}({printable(self.reason)})" if self.reason else self.word.label
        if self.superseded_by is not None:
            what = f"{self.word.label}(by {self.superseded_by})"
        if self.percent is not None:
            what += f" {self.percent} %"
        if not self.observed:
            what += ", effect not observed"
        late = f", {self.late_ms} ms late" if self.late_ms else ""
        alone = f", by the word of {self.signer} alone" if self.is_of_activator and self.is_last else ""
        return f"{who}: {self.command} {'settled as ' if self.settled else ''}{what}{late}{alone}"


class Outcomes(tuple[Outcome, ...]):
    """The result of a broadcast: the last word of each drone, by its number.

    Where the fog denied the whole broadcast, or sent no roster, there is one outcome with `drone` None.
    """

    @classmethod
    def of(cls, said: Iterable[Outcome]) -> Self:
        """The last words among these outcomes."""
        return cls(sorted((outcome for outcome in said if outcome.is_last), key=lambda outcome: outcome.drone or 0))

    @property
    def completed(self) -> bool:
        """Whether there was at least one drone, and all have done it."""
        return bool(self) and all(outcome.completed for outcome in self)


def last_word(said: Sequence[object]) -> Outcome:
    """The last word on a command to one drone; of a choice that sent none, the outcome that says why.

    Of the drones of a choice it is the one that has the command: others may deny it later (R7.8).
    """
    last = [outcome for outcome in said if isinstance(outcome, Outcome) and outcome.is_last]
    return next((outcome for outcome in reversed(last) if outcome.word not in PASSED_OVER), last[-1])


@dataclass(frozen=True)
class StateUpdate:
    """A `state` of a `drone` of a `fog` has arrived.

    `stamp` distinguishes it from the drone's other states; `age_ms` is an upper bound of its age when it arrived.
    `fleet` is as in `Outcome`.
    """

    fog: int
    drone: int
    state: State
    stamp: int
    age_ms: int | None
    fleet: str = ""


@dataclass(frozen=True)
class Reachability:
    """A `drone` of a `fog` has become `reachable` or unreachable; `fleet` is as in `Outcome`."""

    fog: int
    drone: int
    reachable: bool
    fleet: str = ""


@dataclass(frozen=True)
class ControlChanged:
    """The control of a `drone` of a `fog` has changed.

    `holder` is the name of the station in control, None if there is none; `mine` whether it is this one; `epoch` rises
    with each takeover. `fleet` is as in `Outcome`.
    """

    fog: int
    drone: int
    holder: str | None
    mine: bool
    epoch: int
    fleet: str = ""


@dataclass(frozen=True)
class PsmiList:
    """A `fog`'s PSMI list for the command `id`: the drones `listed`, soonest first, and those `left_out`, and why.

    `chosen` is the drone that got the command or, in an offer, is reserved. `fleet` is as in `Outcome`.
    """

    fog: int
    id: CommandId
    listed: tuple[Candidate, ...]
    left_out: tuple[Candidate, ...]
    chosen: int | None
    fleet: str = ""

    def __str__(self) -> str:
        lines = [f"fog {in_fleet(self.fleet, self.fog)}: PSMI {[candidate.drone for candidate in self.listed]}"]
        lines += [
            f"  drone {c.drone}: {c.distance_m:.0f} m, {c.arrival_s:.1f} s"
            for c in self.listed
            if c.distance_m is not None and c.arrival_s is not None
        ]
        return "\n".join(lines + [f"  drone {c.drone} left out: {printable(c.reason or '')}" for c in self.left_out])


@dataclass(frozen=True)
class QodsRanking:
    """QoDS: the `ranking` of the available drones of a `fog`, best first; `fleet` is as in `Outcome`."""

    fog: int
    ranking: tuple[Ranked, ...]
    fleet: str = ""


@dataclass(frozen=True)
class SensorReading:
    """A `value` that a `sensor` measured and a `drone` carried to its `fog`.

    Each (drone, sensor, boot, seq) is reported once: `boot` is random at each start of the sensor, `seq` counts its
    readings.
    `kind` is the measured quantity and `unit` its unit, empty for a bare number. `time_ms` is the time of measurement,
    in milliseconds since 1970 UTC by the sensor's own clock. `fleet` is as in `Outcome`.
    """

    fog: int
    drone: int
    sensor: int
    boot: int
    seq: int
    kind: str
    value: float
    unit: str
    time_ms: int
    fleet: str = ""

    def __str__(self) -> str:
        unit = f" {printable(self.unit)}" if self.unit else ""
        return f"drone {in_fleet(self.fleet, self.drone)} sensor {self.sensor}: {self.kind} {self.value:g}{unit}"


@dataclass(frozen=True)
class ListBehind:
    """A `node` (`drone3`, `fog1`, or this station itself) has an old revocation list, in a fleet that signs.

    It has reported that list for 30 s, through a `fog`. `number` is its list's, `newest` the highest that any node has
    reported. The newer list is withheld from the node, or the node cannot take it. `fleet` is as in `Outcome`.
    """

    fog: int
    node: str
    number: int
    newest: int
    fleet: str = ""

    def __str__(self) -> str:
        node = f"{self.fleet}: {self.node}" if self.fleet else self.node
        return f"{node}: revocation list {self.number}, while there is a list {self.newest}: it may be withheld"


Event = Outcome | StateUpdate | Reachability | ControlChanged | PsmiList | QodsRanking | SensorReading | ListBehind
