"""An activator's record of a command: the legs to its drones, and each leg's words."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from ..core.effects import Publish
from ..core.ledger import Entry
from ..core.settings import Retry
from ..protocol.commands import Goto, Land, Offboard, Resume, Return, StartMission, Takeoff
from ..protocol.messages import CommandMessage, ResultMessage
from ..security.cose import Envelope
from .signed_commands import SignedCommand

CHOSEN = 0
"""The target of a command for which PSMI chooses the drone."""
FLYING = (Takeoff, Goto, Land, Return, Offboard, StartMission, Resume)
"""A drone is busy from one of these commands to its last word."""


@dataclass
class Leg:
    """A command for one drone, and its words; `signed` has the envelopes of the words that the drone signed.

    `truth` is the `settled` word after an `unconfirmed`. `said` has the newest word, and the truth if there is one, as
    published, to answer repetitions.
    """

    drone: int
    sent: CommandMessage | None = None
    publishes: int = 0
    words: list[ResultMessage] = field(default_factory=list)
    retry: Retry | None = None
    waits: bool = False
    """Whether a question waits for its turn, which `retry` then tries."""
    second_ms: int | None = None
    """When to send it over every connection, unless a word has arrived (R19.5)."""
    truth: ResultMessage | None = None
    said: list[Publish] = field(default_factory=list)
    signed: dict[ResultMessage, Envelope] = field(default_factory=dict)

    @property
    def is_closed(self) -> bool:
        return bool(self.words) and self.words[-1].word.is_last

    @property
    def has_begun(self) -> bool:
        """Whether the drone has said a first word of it: a definite no is then never the truth (R5.9)."""
        return bool(self.words) and not self.words[0].word.is_last


@dataclass
class Job:
    """The activator's record of a command: where it was sent, its deadline, and its answers.

    `target` is a drone's number, None for a broadcast, `CHOSEN` if PSMI chooses; while it is `choosing`, another leg
    may follow. `signed` has the envelopes that its station signed for each drone, None if messages are not signed.
    `listed` is PSMI's list, as it was published last, and `answer` the message about the command as a whole: roster or
    denial.
    """

    target: int | None
    message: CommandMessage
    deadline_ms: int
    close_at_ms: int
    query: bool
    signed: SignedCommand | None = None
    legs: dict[int, Leg] = field(default_factory=dict)
    listed: Publish | None = None
    answer: Publish | None = None
    choosing: bool = False

    @property
    def answers(self) -> list[Publish]:
        """What was published about it, to answer repetitions: list, roster or denial, and each leg's newest words."""
        whole = [one for one in (self.listed, self.answer) if one is not None]
        return [*whole, *(word for leg in self.legs.values() for word in leg.said)]

    @property
    def is_over(self) -> bool:
        return not self.choosing and all(leg.is_closed for leg in self.legs.values())


def busy_drones(entries: Iterable[Entry[Job]]) -> set[int]:
    """The drones with a flying command that has no last word yet."""
    return {
        leg.drone
        for entry in entries
        for leg in entry.record.legs.values()
        if not leg.is_closed and isinstance(entry.record.message.command, FLYING)
    }
