"""The words about commands: recorded before they leave, published, and repeated until they are delivered."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from ..core.channel import Channel
from ..core.clock import stamp
from ..core.effects import Audit, Publish
from ..core.floods import Repetitions
from ..core.ledger import Entry, Ledger
from ..core.settings import NO_MATCHING_SUBSCRIBERS
from ..protocol.messages import BeaconMessage, By, CommandId, ResultMessage, Word, without_contradiction
from ..protocol.topics import FogSide
from ..protocol.words import NO_DEADLINE
from .effects import Effect, Journal
from .first_words import FirstWords
from .holder import Authority
from .runs import Output, Said

KEPT_BACK_MS = 1000
"""How long a result waits to be published again, if it had no subscriber or the broker refused it."""


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


class Answers:
    """The words of one UAV client session, kept in `ledger`.

    `unfinished` are commands of earlier sessions. `may_publish` is set while the client is born. `has_paths`: the
    client has several connections to the fog.
    """

    def __init__(
        self,
        drone: int,
        session: int,
        channel: Channel,
        topics: FogSide,
        ledger: Ledger[CommandResults],
        unfinished: list[Unfinished],
        *,
        has_paths: bool,
    ) -> None:
        self.may_publish = False
        self._drone = drone
        self._session = session
        self._channel = channel
        self._topics = topics
        self._results = topics.commands_result(drone, "")
        self._ledger = ledger
        self._repetitions: Repetitions[CommandId] = Repetitions()
        settings = channel.settings
        # Over several connections no word waits: a command without an early word is sent over another one.
        self._first_words = FirstWords(settings.bundle_ms if settings.bundles and not has_paths else None)
        self._republish_at_ms: int | None = None
        self._restored = list(unfinished)
        for left in self._restored:
            ledger.enter(left.id, None, CommandResults(left.command, is_journalled=True), 0)

    def give(self, outputs: list[Output], now_ms: int) -> list[Effect]:
        """Turn words into results, recorded in ledger and journal before they leave, and pass other effects on."""
        out: list[Effect] = []
        for output in outputs:
            if not isinstance(output, Said):
                out.append(output)
                continue
            entry = self._ledger.get(output.id)
            assert entry is not None
            record = entry.record
            earlier = record.newest.word if record.newest is not None else None
            word, reason = without_contradiction(output.word, output.reason, earlier)
            record.newest = result_of(replace(output, word=word, reason=reason), self._session, now_ms)
            record.said = None
            if word.is_last:
                self._ledger.close(entry, now_ms)
                out.append(self._audited(record.newest, now_ms))
                record.is_journalled = record.is_journalled or not word.is_definite_no
                if record.is_journalled:
                    out.append(Journal(entry.id, record.name, word, reason))
            if not self._first_words.waits(record.newest, now_ms):
                out += self._say(record)
        return out

    def again(self, entry: Entry[CommandResults], now_ms: int) -> list[Effect]:
        """Answer a repetition of a command, now or in `repeated`."""
        is_answered = self.may_publish and entry.record.newest is not None
        return self._say(entry.record) if is_answered and self._repetitions.may_answer(entry.id, now_ms) else []

    def deny(self, name: str, command_id: CommandId, reason: str, now_ms: int) -> list[Effect]:
        """Deny a command of which the ledger keeps nothing; repetitions of it are answered more and more rarely."""
        if not self._repetitions.may_answer(command_id, now_ms):
            return []
        denial = result_of(Said(command_id, Word.DENIED, reason), self._session, now_ms)
        return [*self.say_first_words(), self._published(name, denial, kept=False)]

    def say_first_words(self, besides: CommandId | None = None) -> list[Effect]:
        """Publish the waiting first words before any other word, except that of the command `besides`."""
        waiting = [self._ledger.get(command_id) for command_id in self._first_words.take(besides)]
        return [effect for entry in waiting if entry is not None for effect in self._say(entry.record)]

    def first_words(self, now_ms: int) -> list[Effect]:
        """Publish the waiting first words if the oldest has waited long enough."""
        return self.say_first_words() if self._first_words.is_due(now_ms) else []

    def repeated(self, now_ms: int) -> list[Effect]:
        """Publish the words that are due again."""
        again = (self._ledger.get(command_id) for command_id in self._repetitions.due(now_ms))
        out = [effect for entry in again if entry is not None for effect in self._say(entry.record)]
        if self.may_publish and self._republish_at_ms is not None and now_ms >= self._republish_at_ms:
            self._republish_at_ms = None
            out += self.republish()
        return out

    def republish(self) -> list[Effect]:
        """Repeat the newest word of each command without a delivered last word."""
        records = [entry.record for entry in self._ledger.entries()]
        return [effect for record in records if not record.delivered for effect in self._say(record)]

    def close_restored(self, now_ms: int) -> list[Effect]:
        """Restore the words of earlier sessions; ids still open become `unconfirmed(restarted)`."""
        out: list[Effect] = []
        for left in self._restored:
            entry = self._ledger.get(left.id)
            assert entry is not None
            word, reason = (left.word, left.reason) if left.word else (Word.UNCONFIRMED, "restarted")
            entry.record.newest = result_of(Said(left.id, word, reason), self._session, now_ms)
            entry.record.delivered = left.delivered
            self._ledger.close(entry, now_ms)
            if not left.delivered:
                out += [Journal(left.id, left.command, word, reason), self._audited(entry.record.newest, now_ms)]
        self._restored.clear()
        return out

    def on_published(self, ref: Any, code: int, now_ms: int) -> list[Effect]:
        """A QoS 1 publish with `ref` was acknowledged with an MQTT reason code."""
        entry = self._ledger.get(ref)
        if entry is None or entry.record.delivered or entry.record.last is None:
            return []
        if code == NO_MATCHING_SUBSCRIBERS or code >= 0x80:
            self._republish_at_ms = now_ms + KEPT_BACK_MS
            return []
        return self._delivered(entry.id, entry.record)

    def is_word(self, effect: Effect) -> bool:
        """Whether an effect is a word about a command."""
        return isinstance(effect, Publish) and effect.topic.startswith(self._results)

    def _say(self, record: CommandResults) -> list[Effect]:
        """Publish the newest word while the client is born; otherwise it is published after the birth.

        At QoS 0 no PUBACK confirms it: a station queries for a lost one.
        """
        newest = record.newest
        if newest is None or not self.may_publish:
            return []
        record.said = record.said or self._published(record.name, newest)
        out: list[Effect] = [*self.say_first_words(newest.id), record.said]
        if self._channel.settings.qos == 0 and newest.word.is_last and not record.delivered:
            out += self._delivered(newest.id, record)
        return out

    def _published(self, name: str, result: ResultMessage, kept: bool = True) -> Publish:
        """Publish a result. The PUBACK of a last word that the ledger keeps (`kept`) ends its repetition."""
        topic = self._topics.commands_result(self._drone, name)
        ref = result.id if kept and result.word.is_last else None
        return self._channel.publish(topic, result, ref=ref, everywhere=True)

    def _delivered(self, command_id: CommandId, record: CommandResults) -> list[Effect]:
        """The last word was delivered, and is not published again."""
        record.delivered = True
        return [Journal(command_id, record.name, done=True)] if record.is_journalled else []

    def _audited(self, word: ResultMessage, now_ms: int) -> Audit:
        return Audit("word", word, now_ms, f"drone{self._drone}", self._drone, self._channel.seal is not None)
