"""A ground station's commands: sent with their deadlines, followed to exactly one last word for each drone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Any

from ..core.channel import Channel
from ..core.clock import DEFAULT_TTL_MS, MAX_TTL_MS, expiry_s
from ..core.effects import Effect, Log, Publish
from ..core.ledger import KEEP_MS, OVERRIDING
from ..core.overriding import SAFETY, LaterHolds
from ..core.settings import GRACE_MS, TOGETHER_MS, Retry
from ..errors import ConfigurationError, FogUnreachable
from ..protocol.commands import BROADCASTABLE, Command, Offboard
from ..protocol.fields import Scaled
from ..protocol.messages import CommandId, CommandMessage, FogResultMessage, Limit, ResultMessage, Word
from ..protocol.rankings import PsmiMessage, SelectMessage, SelectMode
from ..protocol.topics import SELECTABLE
from ..protocol.values import mark_of
from .fog import LINK, FogView
from .outcomes import Event, Outcome, PsmiList
from .pending import Pending

if TYPE_CHECKING:
    from ..security.addressed import Addressed
    from .signing import CommandSigner

Output = Effect | Event

_LIMIT: Scaled = mark_of(Limit)


def ttl_ms_of(ttl_s: float) -> int:
    """A ttl in whole milliseconds; raises ConfigurationError unless it is above 0 and at most 60 s (R4.7)."""
    if not 0 < ttl_s <= MAX_TTL_MS / 1000:
        raise ConfigurationError(f"ttl {ttl_s:g} s: expected more than 0 and at most {MAX_TTL_MS / 1000:g}")
    return max(1, round(ttl_s * 1000))


def check_limit(limit_s: float | None) -> None:
    """Raises ConfigurationError for a limit that no command can have; None is the command's own."""
    if limit_s is not None and not _LIMIT.low <= limit_s <= _LIMIT.high:
        raise ConfigurationError(f"limit {limit_s:g} s: expected {_LIMIT.low:g} to {_LIMIT.high:g}")


class StationCommands:
    """The commands of one ground station session, by their ids."""

    def __init__(self, session: int, channel: Channel) -> None:
        self.pending: dict[CommandId, Pending] = {}
        self._open: dict[CommandId, Pending] = {}
        self._closed: list[tuple[int, CommandId]] = []
        """A heap of the closed commands, by the time until which each is kept."""
        self._session = session
        self._channel = channel
        self._settings = channel.settings
        self._signer: CommandSigner | None = None
        if channel.seal is not None:
            from .signing import CommandSigner

            self._signer = CommandSigner(channel.seal, channel.settings.encoding)
        self._seq = 0
        self.overriding_seq = -1
        """The sequence number of the last hold, land or return, sent or not."""
        self._later_holds = LaterHolds()

    def send(
        self,
        fog: FogView,
        drone: int | None,
        command: Command,
        now_ms: int,
        *,
        ttl_ms: int = DEFAULT_TTL_MS,
        limit_s: float | None = None,
    ) -> tuple[CommandId, list[Output]]:
        """Send a command to a drone, or with None to every drone of a fog.

        Raises FogUnreachable when the activator is not live or, where commands are signed, a drone's clock is not
        known; ConfigurationError for an invalid ttl, limit or broadcast, and for a missing right.
        """
        if drone is None and not isinstance(command, BROADCASTABLE):
            raise ConfigurationError(f"broadcast {command.name}: expected a command that is the same for every drone")
        if isinstance(command, OVERRIDING):  # also if it cannot be sent: nothing older is repeated past it
            self.overriding_seq = self._seq + 1
            self._later_holds.note(fog.number, drone, self.overriding_seq)
        if self._signer is not None and drone is not None:
            self._signer.check(fog, drone, command)
        common = self._addressed(fog, command, ttl_ms, limit_s, now_ms)
        message = CommandMessage(**common, command=command)
        topic = fog.topics.broadcast if drone is None else fog.topics.drone_commands(drone)
        signed = self._signer.sign(fog, drone, message, ttl_ms, now_ms) if self._signer is not None else None
        pending = self._pend(fog, drone, message, topic, signed, ttl_ms, now_ms)
        pending.roster = None if drone is None else (drone,)
        pending.signed_for = tuple(signed.entries) if signed is not None else ()
        return message.id, [pending.publish]

    def select(
        self,
        fog: FogView,
        command: Command,
        now_ms: int,
        *,
        mode: SelectMode = SelectMode.SELECT,
        reservation: int | None = None,
        drone: int | None = None,
        ttl_ms: int = DEFAULT_TTL_MS,
        limit_s: float | None = None,
    ) -> tuple[CommandId, list[Output]]:
        """Let a fog choose the drone for a command, or take one step of a choice across fogs; errors as `send`.

        `limit_s` of an offer is how long the reservation holds. Where commands are signed, a commit names the `drone`,
        and a select, by which the fog would choose, is refused.
        """
        if command.name not in SELECTABLE:
            raise ConfigurationError(f"{command.name}: expected a command that PSMI ranks: {', '.join(SELECTABLE)}")
        if mode is SelectMode.SELECT and self._signer is not None:
            raise ConfigurationError(f"select {command.name}: expected an offer and a commit, as commands are signed")
        signer = self._signer if mode is SelectMode.COMMIT else None
        if signer is not None and drone is not None:
            signer.check(fog, drone, command)
        common = self._addressed(fog, command, ttl_ms, limit_s, now_ms)
        message = SelectMessage(**common, mode=mode, reservation=reservation, command=command)
        signed = None
        if signer is not None and drone is not None:
            signed = signer.sign(fog, drone, message.as_command(), ttl_ms, now_ms, reservation)
        pending = self._pend(fog, None, message, fog.topics.select(command.name), signed, ttl_ms, now_ms)
        pending.mode = mode
        pending.committed = drone
        pending.denied = mode is SelectMode.RELEASE
        return message.id, [pending.publish]

    def check_right(self, drone: int, command: Command) -> None:
        """Raises ConfigurationError where commands are signed, and the certificate does not allow this one."""
        if self._signer is not None:
            self._signer.check_right(drone, command)

    def _addressed(
        self, fog: FogView, command: Command, ttl_ms: int, limit_s: float | None, now_ms: int
    ) -> dict[str, Any]:
        """The fields that every command to a fog has; takes the next sequence number."""
        if not 0 < ttl_ms <= MAX_TTL_MS:
            raise ConfigurationError(f"ttl {ttl_ms} ms: expected more than 0 and at most {MAX_TTL_MS}")
        check_limit(limit_s)
        deadline_ms = fog.clock.deadline_ms(now_ms, ttl_ms) if fog.clock is not None else None
        if deadline_ms is None or not fog.registered or not fog.is_live(now_ms):
            raise FogUnreachable(f"fog {fog.number}: no live activator; {command.name} was not sent")
        self._seq += 1
        return {
            "gs_session": self._session,
            "seq": self._seq,
            "executor_session": fog.session,
            "deadline_ms": max(0, deadline_ms),
            "limit_s": command.limit_s if limit_s is None else limit_s,
            "epoch": fog.epoch,
        }

    def _pend(
        self,
        fog: FogView,
        drone: int | None,
        message: CommandMessage | SelectMessage,
        topic: str,
        signed: Addressed | None,
        ttl_ms: int,
        now_ms: int,
    ) -> Pending:
        payload = self._channel.payload(topic, message) if signed is None else signed.encode()
        pending = self.pending[message.id] = Pending(
            message.id,
            fog.number,
            drone,
            message.command,
            Publish(LINK, topic, payload, self._settings.qos, expiry_s=expiry_s(ttl_ms)),
            due_ms=now_ms + ttl_ms,
            close_at_ms=now_ms + ttl_ms + round(message.limit_s * 1000) + 2 * GRACE_MS,
            retry=Retry.of(self._settings.qos, now_ms, ttl_ms, self._waits_ms(drone, message)),
            roster=None,
        )
        self._open[message.id] = pending
        return pending

    def _waits_ms(self, drone: int | None, message: CommandMessage | SelectMessage) -> int:
        """How long the activator may hold back its words on a command (R10.6)."""
        is_broadcast = drone is None and isinstance(message, CommandMessage)
        is_urgent = isinstance(message.command, OVERRIDING)
        return TOGETHER_MS if is_broadcast and self._settings.bundles and not is_urgent else 0

    def on_result(
        self, fog: FogView, drone: int, result: ResultMessage, now_ms: int, signer: str | None = None
    ) -> list[Output]:
        """Take a word about a command; `signer` is the node that signed it, None without signatures."""
        pending = self.pending.get(result.id)
        if pending is None or pending.fog != fog.number:
            return []  # another station's, or one that was forgotten
        if not pending.admits(drone):
            return [Log("foreign_result", f"drone {drone} on {result.id}, which was not sent to it")]
        age_ms = None
        if fog.clock is not None and result.relay_stamp is not None:
            age_ms = fog.clock.age_ms(result.relay_stamp, now_ms)
        outcome = Outcome(
            pending.id,
            fog.number,
            drone,
            pending.command.name,
            result.word,
            result.reason,
            result.percent,
            result.late_ms,
            CommandId(result.by.gs_session, result.by.seq) if result.by is not None else None,
            settled=bool(result.settled),
            age_ms=age_ms,
            observed=result.observed is not False,
            signer=signer,
        )
        return [*pending.hear(outcome, self._settings.qos, now_ms)]

    def on_psmi(self, fog: FogView, message: PsmiMessage, now_ms: int) -> list[Output]:
        pending = self.pending.get(message.id)
        if pending is None or pending.fog != fog.number or pending.mode is None:
            return []  # another station's, or of a command that PSMI does not choose for
        if pending.mode is SelectMode.OFFER:
            pending.denied = pending.denied or message.hold_until_ms is not None  # answered: nothing flies by it
        elif message.chosen is not None:
            pending.admits(message.chosen)
        return [PsmiList(fog.number, message.id, message.listed, message.left_out, message.chosen)]

    def on_fog_result(self, fog: FogView, result: FogResultMessage, now_ms: int) -> list[Output]:
        pending = self.pending.get(result.id)
        if pending is None or pending.fog != fog.number or pending.drone is not None or not pending.is_open:
            return []
        if result.denied is not None:
            signer = fog.name if self._channel.seal is not None else None
            if pending.has_begun:
                return self._say_to_open(pending, Word.DENIED, result.denied, now_ms, signer)
            if pending.roster is not None and not pending.choosing:
                return []
            pending.denied, pending.denied_by = True, signer
            name = pending.command.name
            return [Outcome(pending.id, fog.number, None, name, Word.DENIED, result.denied, signer=signer)]
        if pending.roster is None and result.roster is not None and pending.mode is None:
            if self._settings.qos == 0 and not pending.words and not isinstance(pending.command, OVERRIDING):
                pending.retry = Retry.of(0, now_ms, 0, TOGETHER_MS)
            pending.roster = tuple(entry.drone for entry in result.roster)
            missing = tuple(drone for drone in pending.signed_for if drone not in pending.roster)
            pending.roster += missing  # the command was signed for them: whatever the roster says, they may have it
            if missing:
                return [Log("missing_from_roster", f"fog {fog.number} left drones {missing} out of {result.id}")]
        return []

    def ask_again(self, fog_number: int, now_ms: int) -> list[Output]:
        """The same bytes again after a lost connection: a duplicate is answered, not executed."""
        asked = (pending for pending in self.pending.values() if pending.fog == fog_number and pending.is_open)
        return [pending.publish for pending in asked if self._may_repeat(pending, now_ms)]

    def _may_repeat(self, pending: Pending, now_ms: int) -> bool:
        """Whether its repetition could not start what a later hold, land or return has overridden (R10.1)."""
        if now_ms >= pending.due_ms or pending.words:  # a question, or one that the executor has: it is answered
            return True
        if isinstance(pending.command, SAFETY) or pending.mode is SelectMode.RELEASE:
            return True
        if pending.mode is not None:
            return pending.id.seq >= self.overriding_seq
        return not self._later_holds.overrides(pending.fog, pending.drone, pending.id.seq)

    def sign_again(self) -> None:
        """Sign the open commands with the newest key for their repetitions: an older key may be revoked by then."""
        if self._signer is None:
            return
        for pending in self._open.values():
            publish = pending.publish
            topic = self._channel.signed_topic(publish.topic)
            pending.publish = replace(publish, payload=self._signer.sign_again(topic, publish.payload))

    def tick(self, fogs: Mapping[int, FogView], now_ms: int) -> list[Output]:
        """Repeat the commands that are not answered, and at last give them up."""
        for pending in [pending for pending in self._open.values() if not pending.is_open]:
            del self._open[pending.id]
            heappush(self._closed, (pending.close_at_ms + KEEP_MS, pending.id))
        while self._closed and now_ms > self._closed[0][0]:
            del self.pending[heappop(self._closed)[1]]
        for fog in fogs.values():
            fog.in_offboard = any(
                isinstance(pending.command, Offboard) and pending.fog == fog.number for pending in self._open.values()
            )
        return [
            output
            for pending in list(self._open.values())
            for output in self._tick_one(pending, fogs[pending.fog], now_ms)
        ]

    def _tick_one(self, pending: Pending, fog: FogView, now_ms: int) -> list[Output]:
        if now_ms > pending.close_at_ms:
            return self._give_up(pending, now_ms)
        if pending.retry is None or not fog.registered or not self._may_repeat(pending, now_ms):
            return []
        return [pending.publish] if pending.retry.is_due(now_ms) else []

    def _give_up(self, pending: Pending, now_ms: int) -> list[Output]:
        out = self._say_to_open(pending, Word.UNCONFIRMED, None, now_ms)
        if pending.is_open:
            pending.denied = True
            reason = "no_roster" if pending.roster is None else None
            out.append(Outcome(pending.id, pending.fog, None, pending.command.name, Word.UNCONFIRMED, reason))
        return out

    def _say_to_open(
        self, pending: Pending, word: Word, reason: str | None, now_ms: int, signer: str | None = None
    ) -> list[Output]:
        """Close the command for each drone that has no last word."""
        out: list[Output] = []
        for drone in pending.open_drones():
            outcome = Outcome(pending.id, pending.fog, drone, pending.command.name, word, reason, signer=signer)
            out += pending.hear(outcome, self._settings.qos, now_ms)
        return out
