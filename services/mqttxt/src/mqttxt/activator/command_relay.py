"""The activator's relay of commands: admit, forward within the deadline, close the unanswered.

Before it publishes a command to the fog broker only the activator may close it; afterwards only the UAV
client, until the deadline, the limit and a grace have passed. A command that names an earlier session of this
activator is never executed: that session may have forwarded it, so the drones are asked for its outcome.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

from ..core.clock import MAX_TTL_MS, expiry_s
from ..core.effects import Audit, Effect, Inbound, Log, Publish
from ..core.floods import STATION_AT_ONCE, STATION_PER_S, TokenBucket
from ..core.ledger import FOG_CAPACITY, OVERRIDING, Admission, Entry, Ledger, Share
from ..core.overriding import SAFETY, LaterHolds
from ..core.settings import GRACE_MS, NO_MATCHING_SUBSCRIBERS, QUERY_DEADLINE_MS, Retry
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.commands import BROADCASTABLE, Offboard
from ..protocol.identify import identify
from ..protocol.messages import CommandMessage, RosterEntry, Word
from ..protocol.rankings import SelectMessage, SelectMode
from ..protocol.topics import DroneTopic, FogTopic
from ..protocol.words import NO_DEADLINE, NOT_AUDITED
from .command_words import RelayWords
from .drone_link import DroneLink
from .drones import Drones
from .legs import CHOSEN, Job, Leg
from .part import Part, Site
from .signed_commands import SignedCommand, SignedCommands
from .together import WordsTogether

LIST_PER_PLACE = 10
"""How many drones of a choice's list take one place of the ledger: they need as much memory as a command."""
SECOND_MS = 500
"""How long after a command was sent over one connection it is sent over all, unless a word has arrived (R19.5)."""


class CommandRelay(Part):
    """The commands of one activator session; `words` publishes their results.

    `later_holds` has each hold, land and return, also those that are denied. While `is_audited` returns false, other
    commands than these are denied (R14.6); None: no audit log is required. `has_paths`: the fog has several
    connections.
    """

    def __init__(
        self,
        site: Site,
        drones: Drones,
        together: WordsTogether,
        *,
        has_paths: bool,
        is_audited: Callable[[], bool] | None,
    ) -> None:
        super().__init__(site)
        self._drones = drones
        seal = site.to_cloud.seal
        self.signed = SignedCommands(seal, site.owners) if seal is not None else None
        self.ledger: Ledger[Job] = Ledger(FOG_CAPACITY)
        self.words = RelayWords(site, drones, self.ledger, together)
        self.fog_connected = False
        self.has_paths = has_paths
        self._budget = TokenBucket(STATION_PER_S, STATION_AT_ONCE)
        self.is_audited = is_audited
        self.later_holds = LaterHolds()

    def on_command(self, topic: DroneTopic | FogTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A command for one drone, or for every drone of the fog.

        Where messages are signed, raises PayloadError before anything is answered or entered.
        """
        drone = topic.drone if isinstance(topic, DroneTopic) else None
        signed: SignedCommand | None = None
        verified = self.signed.verified(drone, message.payload) if self.signed is not None else None
        try:
            if verified is None:
                command = decode(CommandMessage, message.payload)
            else:
                command, signed = verified.read()
        except PayloadError as error:
            payload = message.payload if verified is None else verified.payload
            return self.on_malformed(drone, replace(message, payload=payload), error, now_ms)
        entry, out = self.enter(command, drone, command.command, message.retain, now_ms, signed)
        if entry is None:
            return out
        sent = self._broadcast(entry, now_ms) if drone is None else self.forward(entry, drone, now_ms)
        return [*out, *sent]

    def enter(
        self,
        command: CommandMessage,
        target: int | None,
        contents: Hashable,
        retained: bool,
        now_ms: int,
        signed: SignedCommand | None = None,
        select: SelectMessage | None = None,
    ) -> tuple[Entry[Job] | None, list[Effect]]:
        """Admit a command or a `select`; returns its entry, None if it is a duplicate or refused, and the effects."""
        known = command.executor_session == self._session and command.deadline_ms is not None
        deadline_ms = command.deadline_ms if known and command.deadline_ms is not None else now_ms
        keep_ms = min(deadline_ms, now_ms + MAX_TTL_MS)
        in_control = self._leases.controls(command.gs_session, target or None)
        share = Share.of(command.command, in_control)
        station = self._station(command.gs_session)
        if not self._budget.takes((station, isinstance(command.command, OVERRIDING)), now_ms):
            return None, [Log("flood", f"{command.command.name} of {station}: too many")]
        if isinstance(command.command, OVERRIDING):
            self.later_holds.note(command.gs_session, target, command.seq)
        query = command.deadline_ms is not None and command.executor_session not in (0, self._session)
        close_at_ms = keep_ms + round(command.limit_s * 1000) + GRACE_MS
        job = Job(target, command, deadline_ms, close_at_ms, query, signed)
        refusal = self._refusal(job, known, retained, now_ms)
        places = self._places(job, select) if refusal is None else 1
        verdict = self.ledger.examine(command.id, contents, keep_ms, now_ms, share, station, places)
        entry = self.ledger.get(command.id)
        if verdict is Admission.DUPLICATE and entry is not None and entry.record.target == target:
            first = entry.record
            first.signed = first.signed.signed_again(signed) if first.signed is not None else None
            return None, self.words.repeat(entry, now_ms)
        if verdict is Admission.IGNORED or (verdict is Admission.FULL and deadline_ms > keep_ms):
            return None, [
                Log("outsiders", f"{command.command.name} of session {command.gs_session:08x}: no room for it")
            ]
        if verdict is not Admission.NEW:
            if not self.words.repetitions.may_answer(command.id, now_ms):
                return None, []
            reason = "ledger_full" if verdict is Admission.FULL else "id_conflict"
            return None, self.words.deny(target, command.command.name, command.id, reason, now_ms)
        entry = self.ledger.enter(command.id, contents, job, keep_ms, share, station, places)
        out: list[Effect] = [self._audited(command, target, select, now_ms)]
        return (entry, out) if refusal is None else (None, out + self.refuse(entry, refusal, now_ms))

    def _station(self, gs_session: int) -> Hashable:
        """A station's key: the name in its certificate, or its session if messages are not signed."""
        return (self._owners.owner(gs_session) if self.signed is not None else None) or gs_session

    def _audited(self, command: CommandMessage, target: int | None, select: SelectMessage | None, now_ms: int) -> Audit:
        session, is_signed = command.gs_session, self.signed is not None
        who = self._owners.owner(session) if is_signed else self._leases.station(session)
        if select is not None:
            return Audit("select", select, now_ms, who, None, is_signed)
        return Audit("command", command, now_ms, who, target, is_signed)

    def refuse(self, entry: Entry[Job], reason: str, now_ms: int) -> list[Effect]:
        """Deny a command as a whole."""
        job = entry.record
        if job.target is not None and job.target != CHOSEN:
            leg = job.legs[job.target] = Leg(job.target)
            return self.words.close(entry, leg, Word.DENIED, reason, now_ms)
        job.choosing = False
        self.ledger.close(entry, now_ms)
        return self.words.deny_whole(entry, reason, now_ms)

    def on_published(self, ref: Any, code: int, now_ms: int) -> list[Effect]:
        """The PUBACK of a forwarded command; "no matching subscribers" means that it was not published (R5.9).

        If commands are signed, that is not believed: the broker may have delivered the command nevertheless (R12.10).
        """
        command_id, drone = ref
        entry = self.ledger.get(command_id)
        leg = entry.record.legs.get(drone) if entry is not None else None
        if entry is None or leg is None or leg.is_closed or leg.words or leg.publishes > 1:
            return []
        if code == NO_MATCHING_SUBSCRIBERS and not entry.record.query and entry.record.signed is None:
            return self.words.close(entry, leg, Word.UNREACHABLE, "no_subscriber", now_ms)
        return []

    def on_drone_reachable(self, link: DroneLink, now_ms: int) -> list[Effect]:
        """A drone is reachable again: send its open commands once more, as queries if it has a new session."""
        return [
            effect
            for entry in self.ledger.open_entries()
            for leg in [entry.record.legs.get(link.number)]
            if leg is not None and not leg.is_closed
            for effect in self._send_again(entry, leg, link, now_ms)
        ]

    def on_path(self, now_ms: int) -> list[Effect]:
        """The connections to the fog have changed: send open commands over all of them, the same bytes (R19.5)."""
        there = [link for link in self._drones.links.values() if link.announced]
        return [effect for link in there for effect in self.on_drone_reachable(link, now_ms)]

    def tick(self, now_ms: int) -> list[Effect]:
        """Repeat unanswered commands, close overdue ones as `unconfirmed`, and answer repetitions that are due."""
        out = self.words.tick(now_ms)
        for entry in self.ledger.open_entries():
            for leg in [leg for leg in entry.record.legs.values() if not leg.is_closed]:
                link = self._drones.links.get(leg.drone)
                if now_ms > entry.record.close_at_ms:
                    out += self.words.close(entry, leg, Word.UNCONFIRMED, None, now_ms)
                elif link is not None and link.announced and leg.retry is not None and leg.retry.is_due(now_ms):
                    out += self._send_again(entry, leg, link, now_ms)
                elif leg.second_ms is not None and now_ms >= leg.second_ms:
                    leg.second_ms = None
                    out += self._send_again(entry, leg, link, now_ms) if not leg.words else []
        return out

    def _refusal(self, job: Job, known: bool, retained: bool, now_ms: int) -> str | None:
        if retained:
            return "retained"
        if not known and not job.query:
            return NO_DEADLINE
        if job.deadline_ms > now_ms + MAX_TTL_MS:
            return "deadline_too_far"
        if job.target is None and not isinstance(job.message.command, BROADCASTABLE):
            return "not_broadcastable"
        is_question = job.deadline_ms <= now_ms
        if is_question or isinstance(job.message.command, OVERRIDING) or self.is_audited is None or self.is_audited():
            return None
        return NOT_AUDITED

    def _broadcast(self, entry: Entry[Job], now_ms: int) -> list[Effect]:
        """Send a command to its whole roster, before anything is published to the station about it."""
        job = entry.record
        roster = self._asked(job.query)
        job.legs.update((listed.drone, Leg(listed.drone)) for listed in roster)  # none is over before all are
        said, sent = self.words.say_roster(entry, roster, now_ms), list[Effect]()
        for listed in roster:
            for effect in self.forward(entry, listed.drone, now_ms):
                is_sent = isinstance(effect, Publish) and effect.link == self._to_fog.link
                (sent if is_sent else said).append(effect)
        if not job.legs:
            self.ledger.close(entry, now_ms)
        return [*sent, *said]

    def _places(self, job: Job, select: SelectMessage | None) -> int:
        """The places that a command takes in the ledger: one per drone that may get it, or per LIST_PER_PLACE."""
        if job.target not in (None, CHOSEN):
            return 1
        asked = len(self._asked(job.query))
        if select is not None and not job.query:
            asked = 1 if select.mode in (SelectMode.COMMIT, SelectMode.RELEASE) else asked // LIST_PER_PLACE
        return max(1, asked)

    def _asked(self, query: bool) -> tuple[RosterEntry, ...]:
        """The drones of a broadcast, or of a query to all."""
        return self._drones.asked() if query else self._drones.roster()

    def forward(self, entry: Entry[Job], drone: int, now_ms: int) -> list[Effect]:
        """Send a command to a drone for the first time, or close it; once it is sent, only the drone may close it."""
        job, link = entry.record, self._drones.links.get(drone)
        leg = job.legs.setdefault(drone, Leg(drone))
        remaining_ms = job.deadline_ms - now_ms
        is_forgotten = self.ledger.may_have_forgotten(entry.id)
        if (remaining_ms <= 0 or is_forgotten) and not job.query:
            word = Word.UNCONFIRMED if is_forgotten else Word.EXPIRED
            return self.words.close(entry, leg, word, None, now_ms)
        if self._is_overridden(job.message, drone) and not job.query:
            return self.words.close(entry, leg, Word.OVERTAKEN, None, now_ms)
        refusal = job.signed.refusal(job.message.command, drone, job.query) if job.signed is not None else None
        if refusal is not None:
            return self.words.close(entry, leg, Word.DENIED, refusal, now_ms)
        if job.query:
            leg.retry = Retry.of(0, now_ms, 0)
            return self._send_again(entry, leg, link, now_ms) if link is not None and link.announced else []
        if link is None or not link.announced or not self.fog_connected:
            return self.words.close(entry, leg, Word.UNREACHABLE, None, now_ms)
        refusal = self._leases.refusal(drone, job.message.gs_session, job.message.epoch, now_ms)
        if refusal is not None:
            return self.words.close(entry, leg, Word.DENIED, refusal, now_ms)
        deadline_ms = link.clock.deadline_ms(now_ms, remaining_ms) if link.clock is not None else None
        if deadline_ms is None or deadline_ms <= 0 or link.session is None:
            return self.words.close(entry, leg, Word.UNREACHABLE, "no_beacon", now_ms)
        epoch = min(job.message.epoch, self._leases.newest_epoch)  # an earlier session may have counted further
        leg.sent = replace(job.message, executor_session=link.session, deadline_ms=deadline_ms, epoch=epoch)
        leg.retry = Retry.of(self._to_fog.settings.qos, now_ms, remaining_ms)
        leg.second_ms = now_ms + SECOND_MS if self.has_paths else None
        if isinstance(job.message.command, Offboard):
            link.in_offboard, link.next_lease_ms = True, now_ms
        return [self._publish_command(entry, leg, remaining_ms)]

    def _send_again(self, entry: Entry[Job], leg: Leg, link: DroneLink | None, now_ms: int) -> list[Effect]:
        """Send the same bytes again; a query behind a new session, lost control, or a later hold (R10.1)."""
        if link is None or link.session is None or not self.fog_connected:
            return []
        message, remaining_ms = entry.record.message, entry.record.deadline_ms - now_ms
        is_same = leg.sent is not None and leg.sent.executor_session == link.session
        is_question = not is_same or self._is_overridden(message, leg.drone)
        is_question |= self._leases.refusal(leg.drone, message.gs_session, message.epoch, now_ms) is not None
        if (is_question or remaining_ms <= 0) and not self.words.may_ask(entry, leg, now_ms):
            return []
        if is_question:
            leg.sent = replace(message, executor_session=link.session, deadline_ms=QUERY_DEADLINE_MS)
        return [self._publish_command(entry, leg, remaining_ms)]

    def _is_overridden(self, message: CommandMessage, drone: int) -> bool:
        """Whether a later hold, land or return to a drone has come, and the command does not stop it too (R5.4)."""
        is_held = self.later_holds.overrides(message.gs_session, drone, message.seq)
        return is_held and not isinstance(message.command, SAFETY)

    def _publish_command(self, entry: Entry[Job], leg: Leg, remaining_ms: int) -> Publish:
        assert leg.sent is not None
        leg.publishes += 1
        topic, signed, qos = self._fog.commands(leg.drone), entry.record.signed, self._to_fog.settings.qos
        if signed is None:
            payload = self._to_fog.payload(topic, leg.sent)
        else:
            payload = signed.for_drone(leg.drone, leg.sent.deadline_ms or QUERY_DEADLINE_MS)
        ref, everywhere = (entry.id, leg.drone), leg.publishes > 1 or isinstance(entry.record.message.command, SAFETY)
        expiry = expiry_s(remaining_ms)
        return Publish(self._to_fog.link, topic, payload, qos, expiry_s=expiry, ref=ref, everywhere=everywhere)

    def on_malformed(self, drone: int | None, message: Inbound, error: PayloadError, now_ms: int) -> list[Effect]:
        out: list[Effect] = [Log(error.kind, f"{message.topic}: {error}")]
        known = identify(message.payload)
        if known is None or self.ledger.get(known) is not None:
            return out
        is_taken = self._budget.takes((self._station(known.gs_session), False), now_ms)
        if is_taken and self.words.repetitions.may_answer(known, now_ms):
            out += self.words.deny(drone, "malformed", known, str(error), now_ms)
        return out
