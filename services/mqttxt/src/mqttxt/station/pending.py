"""A ground station's own record of a command: where it went, and each drone's newest word."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..core.effects import Log, Publish
from ..core.settings import Retry
from ..protocol.commands import Command
from ..protocol.messages import CommandId, Word, without_contradiction
from ..protocol.rankings import SelectMode
from ..protocol.words import PASSED_OVER
from .outcomes import Outcome


@dataclass
class Pending:
    """A command of this station. `roster` has the drones that it concerns, None until they are known.

    It has to start before `due_ms`; from then on its repetition is a question.

    `signed_for` has the drones that it is signed for, `signers` the signer of each drone's newest word, and `denied_by`
    the signer of the denial of the whole command. `begun` has the drones that have said a first word of it themselves:
    a definite no of theirs is then never the truth (R5.9).

    `mode` is that of a select message, None for a command to a drone or to all of a fog. `committed` is the drone to
    which a commit goes: any other one's word is not about it, because a restarted activator asks every drone (R7.8).
    """

    id: CommandId
    fog: int
    drone: int | None
    command: Command
    publish: Publish
    due_ms: int
    close_at_ms: int
    retry: Retry | None
    roster: tuple[int, ...] | None
    signed_for: tuple[int, ...] = ()
    mode: SelectMode | None = None
    committed: int | None = None
    words: dict[int, Word] = field(default_factory=dict)
    signers: dict[int, str | None] = field(default_factory=dict)
    percents: dict[int, int | None] = field(default_factory=dict)
    furthest: dict[int, int] = field(default_factory=dict)
    begun: set[int] = field(default_factory=set)
    unconfirmed_here: set[int] = field(default_factory=set)
    denied: bool = False
    denied_by: str | None = None

    @property
    def choosing(self) -> bool:
        """Whether PSMI may send it to another drone after a definite no."""
        return self.mode is SelectMode.SELECT

    def admits(self, drone: int) -> bool:
        """Whether a drone may have it; one that PSMI may have chosen joins the roster: its list may have been lost."""
        if self.mode is None:
            return self.roster is None or drone in self.roster
        if self.committed not in (None, drone):
            return False
        self.roster = tuple(dict.fromkeys((*(self.roster or ()), drone)))
        return True

    def open_drones(self) -> list[int]:
        """The drones without a last word: of the roster or, while that is not known, of those that answered.

        Once a drone that PSMI sent has ended the choice, those that have said nothing were passed over before (R7.6).
        """
        is_over = self.choosing and any(_ends_a_choice(word) for word in self.words.values())
        concerned = self.words if self.roster is None or is_over else self.roster
        return [n for n in concerned if n not in self.words or not self.words[n].is_last]

    def hear(self, outcome: Outcome, qos: int, now_ms: int) -> list[Log | Outcome]:
        """Take a word, each once: one last word per drone, and at most one that settles an `unconfirmed`.

        `qos` is that of commands: at QoS 0 an open command is repeated after a word, too (R10.1).
        """
        assert outcome.drone is not None
        drone, own = outcome.drone, f"drone{outcome.drone}"
        before = self.words.get(drone)
        if before is None and self.denied_by is not None and outcome.signer == own:
            before = self.words[drone] = Word.DENIED
            self.signers[drone] = self.denied_by
        if before is None or not before.is_last:
            if self._is_known(outcome, drone, before):
                return []
            word, reason = without_contradiction(outcome.word, outcome.reason, before)
            self.percents[drone], self.words[drone], self.signers[drone] = outcome.percent, word, outcome.signer
            if outcome.percent is not None:
                self.furthest[drone] = outcome.percent
            self.retry = Retry.after_word(qos, now_ms)
            if not word.is_last and outcome.signer in (None, own):
                self.begun.add(drone)
            if word is Word.UNCONFIRMED:
                self.unconfirmed_here.add(drone)
            return [replace(outcome, word=word, reason=reason, settled=False)]
        if outcome.word is before or (drone in self.begun and outcome.word.is_definite_no):
            return []
        if drone in self.unconfirmed_here and outcome.signer in (None, own) and outcome.word.is_last:
            self.unconfirmed_here.discard(drone)
            self.words[drone], self.signers[drone] = outcome.word, outcome.signer
            return [replace(outcome, settled=True)]
        return self._contradiction(outcome, before, own)

    def _is_known(self, outcome: Outcome, drone: int, before: Word | None) -> bool:
        """Whether a word is no news: a repetition, a progress that is no further, or a late one after `accepted`."""
        if outcome.word is not Word.IN_PROGRESS or before is None:
            return outcome.word is before
        if before is Word.ACCEPTED or outcome.percent is None:
            return before is Word.ACCEPTED or self.percents[drone] is None
        return outcome.percent <= self.furthest.get(drone, -1)

    def _contradiction(self, outcome: Outcome, before: Word, own: str) -> list[Log | Outcome]:
        """A drone's signed word that contradicts its activator's: a log line and, for a last word, an outcome."""
        assert outcome.drone is not None
        signer = self.signers.get(outcome.drone)
        if signer in (None, own) or outcome.signer != own:
            return []
        line = Log("contradicted", f"{signer} said {before.label} of {outcome.id}, {own} {outcome.word.label}")
        if not outcome.word.is_last:
            return [line]
        self.signers[outcome.drone] = own
        return [line, replace(outcome, settled=True)]

    @property
    def has_begun(self) -> bool:
        """Whether any drone has accepted it, or may have."""
        return any(word not in PASSED_OVER for word in self.words.values())

    @property
    def is_open(self) -> bool:
        if self.denied:
            return False
        if self.roster is None or self.open_drones():
            return True
        return self.choosing and all(word in PASSED_OVER for word in self.words.values())


def _ends_a_choice(word: Word) -> bool:
    """Whether a drone's last word shows that it had the command. `unconfirmed` is also said of those that had not."""
    return word.is_last and word is not Word.UNCONFIRMED and word not in PASSED_OVER
