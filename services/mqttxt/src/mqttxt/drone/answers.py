"""What is kept of a command's words: in the ledger of this session, and of earlier ones in the journal."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.clock import stamp
from ..core.effects import Publish
from ..protocol.messages import BeaconMessage, By, CommandId, ResultMessage, Word
from ..protocol.words import NO_DEADLINE
from .runs import Said


@dataclass
class Answers:
    """A command's results: its name for the topic, the newest word, and whether a last one was acknowledged.

    `said` is that word as it was published, for who asks again.

    `is_journalled`: the journal has it. What was refused before needs no place there: an id that a later session
    does not know is `expired`, a definite no too.
    """

    name: str
    newest: ResultMessage | None = None
    said: Publish | None = None
    delivered: bool = False
    is_journalled: bool = False

    @property
    def last(self) -> ResultMessage | None:
        return self.newest if self.newest is not None and self.newest.word.is_last else None


@dataclass(frozen=True)
class Unfinished:
    """What a journal tells of an earlier session: an id that was open, or a last word, and whether it was delivered.

    A delivered one is kept too: its answer may have died with the fog's broker, and is asked for again then.
    """

    id: CommandId
    command: str
    word: Word | None = None
    reason: str | None = None
    delivered: bool = False


def result_of(said: Said, session: int, now_ms: int) -> ResultMessage:
    """A word of a client session as it is published."""
    return ResultMessage(
        gs_session=said.id.gs_session,
        seq=said.id.seq,
        session=session,
        stamp=stamp(now_ms),
        word=said.word,
        reason=said.reason,
        percent=said.percent,
        late_ms=said.late_ms,
        observed=said.observed,
        by=By(gs_session=said.by.gs_session, seq=said.by.seq) if said.by is not None else None,
        beacon=BeaconMessage(session=session, now_ms=now_ms) if said.reason == NO_DEADLINE else None,
    )
