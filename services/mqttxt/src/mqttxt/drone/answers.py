"""The stored words of commands: this session's in the ledger, those of earlier sessions in the journal."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..core.clock import stamp
from ..core.effects import Publish
from ..protocol.messages import BeaconMessage, By, CommandId, ResultMessage, Word
from ..protocol.words import NO_DEADLINE
from .holder import Authority
from .runs import Said


@dataclass
class CommandResults:
    """A command's results: its name for the topic, the newest word, and whether a last word was acknowledged.

    `said` is that word as it was published, to answer repetitions of the command.

    `is_journalled`: the journal has the command. One that was refused needs no record there: a later session answers
    an unknown id with `expired`, which is a definite no too.
    """

    name: str
    authority: Authority = field(default_factory=Authority)
    newest: ResultMessage | None = None
    said: Publish | None = None
    delivered: bool = False
    is_journalled: bool = False

    @property
    def last(self) -> ResultMessage | None:
        return self.newest if self.newest is not None and self.newest.word.is_last else None


@dataclass(frozen=True)
class Unfinished:
    """A journal's record of an earlier session: an id that was open, or a last word, and whether it was delivered.

    Delivered words are kept too: one may have been lost with the fog's broker, and a query for it follows.
    """

    id: CommandId
    command: str
    word: Word | None = None
    reason: str | None = None
    delivered: bool = False


def result_of(said: Said, session: int, now_ms: int) -> ResultMessage:
    """A word of the client's `session` as a message."""
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
