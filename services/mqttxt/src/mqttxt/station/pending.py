"""A ground station's own record of a command: where it went, and each drone's newest word."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..core.effects import Publish
from ..core.settings import Retry
from ..protocol.commands import Command
from ..protocol.messages import CommandId, Word
from ..protocol.words import PASSED_OVER


@dataclass
class Pending:
    """A command of this station. `roster` are the drones that it concerns, None until that is known.

    `signed_for` are those that it is signed for, `signers` who has signed each drone's newest word, and `denied_by` who
    that no drone has it.

    While it is `choosing`, PSMI may send it to another drone after a definite no.
    """

    id: CommandId
    fog: int
    drone: int | None
    command: Command
    publish: Publish
    close_at_ms: int
    retry: Retry | None
    roster: tuple[int, ...] | None
    signed_for: tuple[int, ...] = ()
    choosing: bool = False
    words: dict[int, Word] = field(default_factory=dict)
    signers: dict[int, str | None] = field(default_factory=dict)
    percents: dict[int, int | None] = field(default_factory=dict)
    unconfirmed_here: set[int] = field(default_factory=set)
    denied: bool = False
    denied_by: str | None = None

    def open_drones(self) -> list[int]:
        """The drones that have no last word: of the roster, or of those that were heard."""
        concerned = self.words if self.roster is None else self.roster
        return [n for n in concerned if n not in self.words or not self.words[n].is_last]

    @property
    def has_begun(self) -> bool:
        """Whether any drone has said that it does it, or may."""
        return any(word not in PASSED_OVER for word in self.words.values())

    @property
    def is_open(self) -> bool:
        if self.denied:
            return False
        if self.roster is None or self.open_drones():
            return True
        return self.choosing and all(self.words[number] in PASSED_OVER for number in self.roster)
