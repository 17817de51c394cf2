"""A UAV client's commands: admitted or denied, and begun once they are in the journal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ..core.channel import Channel
from ..core.clock import MAX_TTL_MS
from ..core.effects import Audit, Inbound, Log
from ..core.floods import STATION_AT_ONCE, STATION_PER_S, TokenBucket
from ..core.ledger import OVERRIDING, Admission, Ledger, Share
from ..core.session_owners import SessionOwners
from ..core.settings import QUERY_DEADLINE_MS
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.identify import identify
from ..protocol.messages import CommandId, CommandMessage, Word
from ..protocol.topics import FogSide
from ..protocol.values import shown
from ..protocol.words import CERTIFICATE_EXPIRED, NO_DEADLINE, NOT_ALLOWED, NOT_AUDITED, NOT_IN_CONTROL
from ..security.cose import Envelope
from ..security.seal import Signed
from .answers import Answers, CommandResults, Unfinished
from .effects import Effect, Journal
from .executor import Executor
from .holder import Holder
from .runs import Said
from .start_order import StartOrder

LINK = "fog"


class CommandDesk:
    """The commands of one UAV client session: ledger, order, executor, and `answers`, the words about them.

    `unfinished` and `has_paths` are `Answers`'; `forgotten` are the commands that the journal has dropped, by their
    highest. `remembers` false: the journal of earlier sessions is missing or has a gap, so the outcome of an id that
    may have been theirs is unknown. `holder` has control by the newest lease. While `is_audited` returns False,
    commands other than hold, land and return are denied (R14.6); None: no audit log is required.
    """

    def __init__(
        self,
        drone: int,
        session: int,
        channel: Channel,
        topics: FogSide,
        executor: Executor,
        owners: SessionOwners,
        *,
        unfinished: list[Unfinished],
        forgotten: list[CommandId],
        remembers: bool,
        has_paths: bool,
        is_audited: Callable[[], bool] | None,
    ) -> None:
        self.ledger: Ledger[CommandResults] = Ledger()
        self._budget = TokenBucket(STATION_PER_S, STATION_AT_ONCE)
        self.answers = Answers(drone, session, channel, topics, self.ledger, unfinished, has_paths=has_paths)
        self.executor = executor
        executor.permit.has_control = self._has_control
        self.holder = Holder(executor.lease, channel.seal is not None)
        self.is_audited = is_audited
        self._drone = drone
        self._session = session
        self._channel = channel
        self._owners = owners
        self._remembers = remembers
        self.order = StartOrder()
        self._to_start: dict[CommandId, CommandMessage] = {}
        for command_id in forgotten:
            self.ledger.forgotten.note(command_id)

    def on_message(self, message: Inbound, now_ms: int) -> list[Effect]:
        """Admit or answer a command. Raises PayloadError for a bad signature, before anything else (R12.9)."""
        payload, signed = self._opened(message)
        try:
            command = decode(CommandMessage, payload)
        except PayloadError as error:
            station = signed.signer if signed is not None else None
            return [Log(error.kind, f"{message.topic}: {error}"), *self._malformed(payload, station, error, now_ms)]
        if signed is None:
            return self._on_command(command, message.retain, now_ms)
        if command.executor_session != self._session or command.deadline_ms is None:
            command = replace(command, executor_session=self._session, deadline_ms=QUERY_DEADLINE_MS)
        tightened = self._tightened(command, signed.envelope.route)
        return self._on_command(tightened, message.retain, now_ms, signed, command.deadline_ms)

    def _opened(self, message: Inbound) -> tuple[bytes, Signed | None]:
        """The payload, and its signature if signed. Raises PayloadError if that or its session is wrong."""
        seal = self._channel.seal
        if seal is None:
            return message.payload, None
        signed = seal.open_of_station(self._channel.signed_topic(message.topic), Envelope.parse(message.payload))
        known = identify(signed.payload)
        if known is None or not self._owners.is_of(known.gs_session, signed.signer):
            raise PayloadError(f"command of {signed.signer}: expected a session of its own", "foreign_session")
        return signed.payload, signed

    def _malformed(self, payload: bytes, station: str | None, error: PayloadError, now_ms: int) -> list[Effect]:
        """Deny a payload that is no valid command, if its command id can be read. `station` signed it."""
        known = identify(payload)
        if known is None or self.ledger.get(known) is not None:
            return []
        if not self._budget.takes((station or known.gs_session, False), now_ms):
            return []
        return self.answers.deny("malformed", known, str(error), now_ms)

    def _tightened(self, command: CommandMessage, route: Any) -> CommandMessage:
        """The command with the earlier deadline: the signed one, or the relay's in the route."""
        assert command.deadline_ms is not None
        relayed_ms = command.deadline_ms if route is None else route
        if type(relayed_ms) is not int or relayed_ms < 0:
            raise PayloadError(f"route {shown(route)}: expected a deadline in milliseconds")
        return replace(command, deadline_ms=min(command.deadline_ms, relayed_ms))

    def _on_command(
        self,
        command: CommandMessage,
        retained: bool,
        now_ms: int,
        signed: Signed | None = None,
        signed_until_ms: int | None = None,
    ) -> list[Effect]:
        """Admit or answer. `signed_until_ms` is the signed deadline: until then the same id may arrive in time."""
        deadline_ms = command.deadline_ms
        if command.executor_session != self._session:
            deadline_ms = None
        until_ms, latest_ms = signed_until_ms or deadline_ms or now_ms, now_ms + MAX_TTL_MS
        known_until_ms = min(until_ms, latest_ms)
        share = Share.of(command.command, self.executor.lease.holder_session == command.gs_session)
        station = signed.signer if signed is not None else command.gs_session
        if not self._budget.takes((station, isinstance(command.command, OVERRIDING)), now_ms):
            return [Log("flood", f"{command.command.name} of {station}: too many")]
        verdict = self.ledger.examine(command.id, command.command, known_until_ms, now_ms, share, station)
        if verdict is Admission.DUPLICATE:
            entry = self.ledger.get(command.id)
            assert entry is not None
            return self.answers.again(entry, now_ms)
        if verdict is Admission.IGNORED or (verdict is Admission.FULL and until_ms > latest_ms):
            return [Log("outsiders", f"{command.command.name} of {command.id}: no room for it")]
        if verdict in (Admission.CONFLICT, Admission.FULL):
            reason = "id_conflict" if verdict is Admission.CONFLICT else "ledger_full"
            return self.answers.deny(command.command.name, command.id, reason, now_ms)
        self.ledger.enter(
            command.id,
            command.command,
            CommandResults(command.command.name, self.holder.authority(command.gs_session, command.epoch)),
            known_until_ms,
            share,
            station,
        )
        self.order.entered(command)
        who = signed.signer if signed is not None else None
        audit = Audit("command", command, now_ms, who, self._drone, signed is not None)
        refusal = self._refusal(command, deadline_ms, retained, now_ms)
        if signed is not None and (refusal is None or refusal.word is not Word.UNCONFIRMED):
            if missing := signed.certificate.rights.missing(command.command, self._drone):
                refusal = Said(command.id, Word.DENIED, f"{NOT_ALLOWED}, {missing}")
            if signed.is_expired and not isinstance(command.command, OVERRIDING):
                refusal = Said(command.id, Word.DENIED, CERTIFICATE_EXPIRED)
        if refusal is not None:
            return [audit, *self.answers.give([refusal], now_ms)]
        self._to_start[command.id] = command
        return [audit, Journal(command.id, command.command.name)]

    def on_journalled(self, command_id: CommandId, now_ms: int) -> list[Effect]:
        """Start a command that is in the journal: a restarted client can report its outcome."""
        command, entry = self._to_start.pop(command_id), self.ledger.get(command_id)
        assert entry is not None
        assert command.deadline_ms is not None
        if self.executor.permit.is_leaving:
            return []  # the next session closes it
        entry.record.is_journalled = True
        refusal = self._refusal(command, command.deadline_ms, False, now_ms)  # the disk may have taken its time
        if refusal is not None:
            return self.answers.give([refusal], now_ms)
        limit_ms = round(command.limit_s * 1000)
        started = self.executor.start(command_id, command.command, command.deadline_ms, limit_ms, now_ms)
        if not any(isinstance(output, Said) and output.id == command_id for output in started):
            self.order.started(command)
        return self.answers.give(started, now_ms)

    def on_not_journalled(self, command_id: CommandId, now_ms: int) -> list[Effect]:
        """Deny a command without a record: a restarted client could not report its outcome."""
        del self._to_start[command_id]
        return self.answers.give([Said(command_id, Word.DENIED, "journal")], now_ms)

    def _refusal(self, command: CommandMessage, deadline_ms: int | None, retained: bool, now_ms: int) -> Said | None:
        """The last word on a new command that must not start; None if it may."""
        if retained:
            return Said(command.id, Word.DENIED, "retained")
        is_of_before = command.executor_session not in (0, self._session) or deadline_ms == QUERY_DEADLINE_MS
        if is_of_before and not self._remembers:
            return Said(command.id, Word.UNCONFIRMED, "no_journal")
        if self.ledger.may_have_forgotten(command.id):
            return Said(command.id, Word.UNCONFIRMED)
        if deadline_ms is None:
            return Said(command.id, Word.DENIED, NO_DEADLINE)
        if deadline_ms > now_ms + MAX_TTL_MS:
            return Said(command.id, Word.DENIED, "deadline_too_far")
        if now_ms > deadline_ms:
            return Said(command.id, Word.EXPIRED)
        if not self.holder.obeys(command.gs_session, command.epoch, now_ms):
            return Said(command.id, Word.DENIED, NOT_IN_CONTROL)
        if self.order.is_overtaken(command):
            return Said(command.id, Word.OVERTAKEN)
        if not (isinstance(command.command, OVERRIDING) or self.is_audited is None or self.is_audited()):
            return Said(command.id, Word.DENIED, NOT_AUDITED)
        return None

    def _has_control(self, command_id: CommandId) -> bool:
        """Whether no other station has taken the place of the one that sent a command that has begun."""
        entry = self.ledger.get(command_id)
        return entry is not None and not entry.record.authority.is_lost

    def on_lease(self, holder_session: int | None, epoch: int, activator: int, until_ms: int | None) -> None:
        """A newer lease of the drone."""
        begun = ((entry.id, entry.record.authority) for entry in self.ledger.open_entries())
        self.holder.on_lease(holder_session, epoch, activator, until_ms, begun)

    def tick(self, now_ms: int) -> list[Effect]:
        """Check deadlines and limits of open commands, and publish the words that are due again."""
        out = self.answers.first_words(now_ms)
        out += self.answers.give(self.executor.tick(now_ms), now_ms)
        return out + self.answers.repeated(now_ms)
