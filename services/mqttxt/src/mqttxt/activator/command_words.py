"""An activator's results: the drones' words that it passes on, and words of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..core.clock import stamp
from ..core.effects import Audit, Effect, Log, Publish
from ..core.floods import STATION_AT_ONCE, STATION_PER_S, Repetitions, TokenBucket
from ..core.ledger import Entry, Ledger
from ..core.settings import Retry
from ..protocol.codec import decode
from ..protocol.commands import Offboard
from ..protocol.messages import (
    BeaconMessage,
    CommandId,
    FogResultMessage,
    ResultMessage,
    RosterEntry,
    Word,
    without_contradiction,
)
from ..protocol.words import NO_DEADLINE
from ..security.cose import Envelope
from .drone_link import DroneLink
from .drones import Drones
from .legs import CHOSEN, Job, Leg
from .part import Part, Site
from .together import WordsTogether
from .unanswered import Unanswered

WORD_BYTES = 200
"""A word that is signed is shorter; a longer answer, as a list of PSMI, counts as several words."""
TURN_MS = 200
"""How often a question is tried that waits for the answers to others."""


class RelayWords(Part):
    """The words about one activator session's commands. `on_last_word` is called for each closed leg of a choice.

    Words are published in their order: those that wait in `together` before any other.
    """

    def __init__(self, site: Site, drones: Drones, ledger: Ledger[Job], together: WordsTogether) -> None:
        super().__init__(site)
        self._together = together
        self.on_last_word: Callable[[Entry[Job], Leg, int], list[Effect]] = lambda entry, leg, now_ms: []
        self._drones = drones
        self._ledger = ledger
        self._questions = Unanswered()
        self.repetitions: Repetitions[CommandId] = Repetitions()
        """When which id was answered again, also one that the ledger has not taken."""
        self._again = TokenBucket(STATION_PER_S, STATION_AT_ONCE)
        """Each station's answers to repetitions: to a broadcast's they are as many words as it has drones."""

    def may_ask(self, entry: Entry[Job], leg: Leg, now_ms: int) -> bool:
        """Whether to send a leg's question now; if not, its turn comes later (R15.8)."""
        if not self._questions.takes((leg.drone, entry.station), now_ms):
            leg.retry, leg.waits = Retry(now_ms + TURN_MS), True
            return False
        if leg.waits:
            leg.waits = False
            leg.retry = Retry.after_word(self._to_cloud.settings.qos, now_ms) if leg.words else Retry.unanswered(now_ms)
        return True

    def on_result(
        self, link: DroneLink, payload: bytes, name: str, now_ms: int, signed: Envelope | None = None
    ) -> list[Effect]:
        """Relay a word of the drone bound to `link`, in its envelope `signed`, unless it repeats an earlier one."""
        result = decode(ResultMessage, payload)
        if result.session != link.session or link.clock is None:
            return [Log("unknown_session", f"result of drone {link.number} from session {result.session:08x}")]
        age_ms = link.clock.age_ms(result.stamp, now_ms)
        relayed = replace(result, relay_stamp=stamp(now_ms - age_ms) if age_ms is not None else None)
        entry = self._ledger.get(result.id)
        if entry is None:
            return [*self._together.flush(now_ms), self._publish(link.number, name, relayed, signed)]
        leg = entry.record.legs.get(link.number)
        if leg is None:
            return [Log("foreign_result", f"drone {link.number} on {result.id}, which was not sent to it")]
        self._questions.answered((link.number, entry.station))
        if leg.is_closed:
            unconfirmed = leg.words[-1].word is Word.UNCONFIRMED and leg.words[-1].session == self._session
            if not unconfirmed or leg.truth or not result.word.is_last or result.word is Word.UNCONFIRMED:
                return []
            if leg.has_begun and result.word.is_definite_no:
                return []
            leg.truth = replace(relayed, settled=True)
            if signed is not None:
                leg.signed[leg.truth] = signed
            leg.said.append(self._publish(link.number, name, leg.truth, signed))
            return [self._audited(leg, leg.truth, now_ms), *self._together.flush(now_ms), leg.said[-1]]
        if any(word.word is result.word and word.percent == result.percent for word in leg.words):
            return []
        earlier = leg.words[-1].word if leg.words else None
        word, reason = without_contradiction(relayed.word, relayed.reason, earlier)
        relayed = replace(relayed, word=word, reason=reason)
        if signed is not None:
            leg.signed[relayed] = signed
        return self._say(entry, leg, relayed, now_ms)

    def close(self, entry: Entry[Job], leg: Leg, word: Word, reason: str | None, now_ms: int) -> list[Effect]:
        """Close a leg with a last word of the activator's own."""
        return self._say(entry, leg, self._own(entry.id, word, reason, now_ms), now_ms)

    def say_roster(self, entry: Entry[Job], roster: tuple[RosterEntry, ...], now_ms: int) -> list[Effect]:
        """Publish the roster of a broadcast."""
        result = self._fog_result(entry.id, roster, None, now_ms)
        name = entry.record.message.command.name
        entry.record.answer = alone = self._publish_of_fog(name, result)
        if entry.record.query or not self._leases.reads_together(entry.id.gs_session):
            return [*self._together.flush(now_ms), alone]
        return [*self._together.open(name, entry.id, roster, alone, now_ms)]

    def deny_whole(self, entry: Entry[Job], reason: str, now_ms: int) -> list[Effect]:
        """Deny a command for the whole fog."""
        result = self._fog_result(entry.id, None, reason, now_ms)
        entry.record.answer = self._publish_of_fog(entry.record.message.command.name, result)
        audit = Audit("word", result, now_ms, self._name, None, self._to_cloud.seal is not None)
        return [audit, *self._together.flush(now_ms), entry.record.answer]

    def deny(self, drone: int | None, name: str, command_id: CommandId, reason: str, now_ms: int) -> list[Effect]:
        """Deny a command that has no place in the ledger."""
        if drone is None or drone == CHOSEN:
            denial = self._publish_of_fog(name, self._fog_result(command_id, None, reason, now_ms))
        else:
            denial = self._publish(drone, name, self._own(command_id, Word.DENIED, reason, now_ms))
        return [*self._together.flush(now_ms), denial]

    def repeat(self, entry: Entry[Job], now_ms: int) -> list[Effect]:
        """Answer a duplicate, unchanged, or later if it was answered within the second."""
        may_answer = bool(entry.record.answers) and self.repetitions.may_answer(entry.id, now_ms)
        return self._repeated(entry, now_ms) if may_answer else []

    def tick(self, now_ms: int) -> list[Effect]:
        """Answer the repetitions that are due."""
        entries = (self._ledger.get(command_id) for command_id in self.repetitions.due(now_ms))
        return [effect for entry in entries if entry is not None for effect in self._repeated(entry, now_ms)]

    def _repeated(self, entry: Entry[Job], now_ms: int) -> list[Effect]:
        """The answers to a repetition; later, if its station was given many (R15.2)."""
        if not self._again.takes(entry.station, now_ms):
            self.repetitions.may_answer(entry.id, now_ms)  # within the second: it is owed
            return []
        answers = entry.record.answers
        self._again.owes(entry.station, now_ms, sum(1 + len(one.payload) // WORD_BYTES for one in answers) - 1)
        return [*self._together.flush(now_ms), *answers]

    def _say(self, entry: Entry[Job], leg: Leg, result: ResultMessage, now_ms: int) -> list[Effect]:
        leg.words.append(result)
        link = self._drones.links.get(leg.drone)
        if leg.is_closed and link is not None and isinstance(entry.record.message.command, Offboard):
            link.in_offboard = self._is_in_offboard(leg.drone)
        leg.retry = Retry.after_word(self._to_cloud.settings.qos, now_ms)
        if entry.record.is_over:
            self._ledger.close(entry, now_ms)
        signed = leg.signed.get(result)
        if entry.record.query and result.word.is_last:
            result = replace(result, beacon=self._beacon(now_ms))
        name, job = entry.record.message.command.name, entry.record
        alone = self._publish(leg.drone, name, result, signed)
        leg.said = [alone]
        out: list[Effect]
        if job.target is None and not job.query and self._leases.reads_together(result.gs_session):
            out = [*self._together.add(name, leg.drone, result, alone, now_ms)]
            if all(leg.is_closed or self._together.waits(leg.drone) for leg in job.legs.values()):
                out += self._together.flush(now_ms)  # no drone is left to wait for
        else:
            out = [*self._together.flush(now_ms), alone]
        if leg.is_closed:
            out.append(self._audited(leg, leg.words[-1], now_ms))
        if leg.is_closed and entry.record.choosing:
            out += self.on_last_word(entry, leg, now_ms)
        return out

    def _audited(self, leg: Leg, word: ResultMessage, now_ms: int) -> Audit:
        """The audit record of a last word, of a drone or of this activator in its place."""
        who = self._name if word.session == self._session else f"drone{leg.drone}"
        is_signed = self._to_cloud.seal is not None and (who == self._name or word in leg.signed)
        return Audit("word", word, now_ms, who, leg.drone, is_signed)

    def _is_in_offboard(self, drone: int) -> bool:
        """Whether an offboard command is open for a drone, so that its lease must be renewed often."""
        jobs = [entry.record for entry in self._ledger.open_entries()]
        legs = [job.legs[drone] for job in jobs if drone in job.legs and isinstance(job.message.command, Offboard)]
        return any(not leg.is_closed for leg in legs)

    def _own(self, command_id: CommandId, word: Word, reason: str | None, now_ms: int) -> ResultMessage:
        return ResultMessage(
            gs_session=command_id.gs_session,
            seq=command_id.seq,
            session=self._session,
            relay_stamp=stamp(now_ms),
            stamp=stamp(now_ms),
            word=word,
            reason=reason,
            beacon=self._beacon(now_ms) if reason == NO_DEADLINE else None,
        )

    def _fog_result(
        self, command_id: CommandId, roster: tuple[RosterEntry, ...] | None, denied: str | None, now_ms: int
    ) -> FogResultMessage:
        return FogResultMessage(
            gs_session=command_id.gs_session,
            seq=command_id.seq,
            session=self._session,
            stamp=stamp(now_ms),
            roster=roster,
            denied=denied,
            beacon=self._beacon(now_ms) if denied == NO_DEADLINE else None,
        )

    def _beacon(self, now_ms: int) -> BeaconMessage:
        return BeaconMessage(session=self._session, now_ms=now_ms)

    def _publish(self, drone: int, name: str, result: ResultMessage, signed: Envelope | None = None) -> Publish:
        """Publish a word; one that its drone signed is passed on unchanged, with the relay's route (R12.11)."""
        topic = self._cloud.drone_result(drone, name)
        if signed is None:
            return self._to_cloud.publish(topic, result)
        payload = signed.routed([result.relay_stamp, bool(result.settled)]).encode()
        return Publish(self._to_cloud.link, topic, payload, self._to_cloud.settings.qos)

    def _publish_of_fog(self, name: str, result: FogResultMessage) -> Publish:
        return self._to_cloud.publish(self._cloud.fog_result(name), result)
