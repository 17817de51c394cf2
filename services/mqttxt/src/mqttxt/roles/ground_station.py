"""The ground station as a state machine: registrations, commands and their outcomes (docs/protocol.md)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..clock import DEFAULT_TTL_MS, MAX_TTL_MS, expiry_s
from ..commands import BROADCASTABLE, Command
from ..errors import ConfigurationError, FogUnreachable, PayloadError
from ..messages import (
    BeaconMessage,
    CommandId,
    CommandMessage,
    Control,
    DroneRecord,
    FogPresence,
    FogResultMessage,
    Presence,
    ResultMessage,
    Word,
)
from ..outcomes import Event, Outcome, PsmiList
from ..rankings import PsmiMessage, QodsMessage, SelectMessage, SelectMode
from ..topics import SELECTABLE, CloudSide, DroneTopic, FogTopic, check_prefix, station_of, station_reachable
from ..wire.bundles import FogBundle, states_of
from ..wire.codec import decode, encode
from ..wire.states import decode_state
from .effects import Effect, Inbound, Log, Publish, Subscribe, Will
from .ledger import KEEP_MS
from .pending import Pending
from .settings import GRACE_MS, REBIRTH_MS, Retry, Settings
from .station_fog import LINK, FogView

DEFAULT_LEASE_S = 30

Output = Effect | Event


class GroundStation:
    """One ground station session. Times are milliseconds of its session clock."""

    def __init__(
        self,
        name: str,
        session: int,
        settings: Settings,
        *,
        prefix: str = "",
        lease_s: int = DEFAULT_LEASE_S,
        control: bool = True,
    ) -> None:
        self.name = name
        self.session = session
        self.settings = settings
        self.fogs: dict[int, FogView] = {}
        self.commands: dict[CommandId, Pending] = {}
        self.connected = False
        self._prefix = check_prefix(prefix)
        self._lease_s = lease_s
        self._control = Control.WANT if control else Control.NONE
        self._presence_topic = station_reachable(name, prefix)
        self._seq = 0
        self._rebirth_at_ms: int | None = None

    def will(self) -> Will:
        """One will serves all fogs of the station."""
        return Will(self._presence_topic, self._presence(up=False))

    def on_connected(self, now_ms: int) -> list[Output]:
        self.connected = True
        out: list[Output] = [Subscribe(LINK, (self._presence_topic,), ref=None)]
        return out + [self._subscribe(fog) for fog in self.fogs.values()]

    def on_disconnected(self, now_ms: int) -> list[Output]:
        self.connected = False
        out: list[Output] = []
        for fog in self.fogs.values():
            fog.subscribed = fog.up = fog.registered = False
            out += fog.tick(now_ms)[1]
        return out

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Output]:
        if subscribe.ref is None:
            return [self._birth(up=True)]
        fog = self.fogs[int(str(subscribe.ref))]
        fog.subscribed = True
        return [fog.registration(now_ms)] if fog.up else []

    def add_fogs(self, numbers: Iterable[int]) -> list[Output]:
        """Take part in more fogs: subscribe, register, and keep the registrations."""
        out: list[Output] = []
        for number in numbers:
            if number in self.fogs:
                continue
            topics = CloudSide(number, self._prefix)
            fog = FogView(topics, self.name, self.session, self._lease_s, self.settings, self._control)
            self.fogs[number] = fog
            if self.connected:
                out.append(self._subscribe(fog))
        return out

    def send(
        self,
        fog_number: int,
        drone: int | None,
        command: Command,
        now_ms: int,
        *,
        ttl_ms: int = DEFAULT_TTL_MS,
        limit_s: float | None = None,
    ) -> tuple[CommandId, list[Output]]:
        """Send a command to a drone, or with None to every drone of a fog.

        Raises FogUnreachable when the activator is not live, ConfigurationError for a ttl or a broadcast
        that cannot be.
        """
        if drone is None and not isinstance(command, BROADCASTABLE):
            raise ConfigurationError(f"broadcast {command.name}: expected a command that is the same for every drone")
        fog, common = self._addressed(fog_number, command, ttl_ms, limit_s, now_ms)
        message = CommandMessage(**common, command=command)
        topic = fog.topics.broadcast if drone is None else fog.topics.drone_commands(drone)
        pending = self._pend(fog, drone, message, topic, ttl_ms, now_ms)
        pending.roster = None if drone is None else (drone,)
        return message.id, [pending.publish]

    def select(
        self,
        fog_number: int,
        command: Command,
        now_ms: int,
        *,
        mode: SelectMode = SelectMode.SELECT,
        reservation: int | None = None,
        ttl_ms: int = DEFAULT_TTL_MS,
        limit_s: float | None = None,
    ) -> tuple[CommandId, list[Output]]:
        """Let a fog choose the drone for a command, or take one step of a choice across fogs; errors as `send`.

        `limit_s` of an offer is how long the reservation holds.
        """
        if command.name not in SELECTABLE:
            raise ConfigurationError(f"{command.name}: expected a command that PSMI ranks: {', '.join(SELECTABLE)}")
        fog, common = self._addressed(fog_number, command, ttl_ms, limit_s, now_ms)
        message = SelectMessage(**common, mode=mode, reservation=reservation, command=command)
        pending = self._pend(fog, None, message, fog.topics.select(command.name), ttl_ms, now_ms)
        pending.choosing = mode is SelectMode.SELECT
        pending.denied = mode is SelectMode.RELEASE
        return message.id, [pending.publish]

    def take_over(self, fog_number: int, drones: tuple[int, ...] | None, now_ms: int) -> list[Output]:
        """Take control of a fog's drones (None: of all), whoever holds it; raises FogUnreachable."""
        fog = self.fogs.get(fog_number)
        if fog is None or not fog.registered or not fog.is_live(now_ms):
            raise FogUnreachable(f"fog {fog_number}: no live activator; control was not taken")
        return [fog.registration(now_ms, take=True, drones=drones)]

    def _addressed(
        self, fog_number: int, command: Command, ttl_ms: int, limit_s: float | None, now_ms: int
    ) -> tuple[FogView, dict[str, Any]]:
        """The fog, and the fields that every command to it has; the sequence number is used up."""
        if not 0 < ttl_ms <= MAX_TTL_MS:
            raise ConfigurationError(f"ttl {ttl_ms} ms: expected more than 0 and at most {MAX_TTL_MS}")
        fog = self.fogs.get(fog_number)
        deadline_ms = fog.clock.deadline_ms(now_ms, ttl_ms) if fog is not None and fog.clock is not None else None
        if fog is None or deadline_ms is None or not fog.registered or not fog.is_live(now_ms):
            raise FogUnreachable(f"fog {fog_number}: no live activator; {command.name} was not sent")
        self._seq += 1
        return fog, {
            "gs_session": self.session,
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
        ttl_ms: int,
        now_ms: int,
    ) -> Pending:
        payload = encode(message, self.settings.encoding)
        pending = self.commands[message.id] = Pending(
            message.id,
            fog.number,
            drone,
            message.command,
            Publish(LINK, topic, payload, self.settings.qos, expiry_s=expiry_s(ttl_ms)),
            close_at_ms=now_ms + ttl_ms + round(message.limit_s * 1000) + 2 * GRACE_MS,
            retry=Retry.of(self.settings.qos, now_ms, ttl_ms),
            roster=None,
        )
        return pending

    def on_message(self, message: Inbound, now_ms: int) -> list[Output]:
        """A message from the cloud broker; what does not follow the specification is counted."""
        try:
            if station_of(message.topic, self._prefix) is not None:
                return self._on_own_presence(decode(Presence, message.payload), now_ms)
            for fog in self.fogs.values():
                if message.topic.startswith(fog.topics.root):
                    return self._on_fog_message(fog, fog.topics.parse(message.topic), message, now_ms)
            raise PayloadError(f"topic {message.topic!r}: not of a fog that was asked for", "topic")
        except PayloadError as error:
            return [Log(error.kind, f"{message.topic}: {error}")]

    def tick(self, now_ms: int) -> list[Output]:
        """Everything that is due by time; to be called at least ten times a second."""
        out: list[Output] = []
        for fog in self.fogs.values():
            effects, events = fog.tick(now_ms)
            out += [*effects, *events]
        if self._rebirth_at_ms is not None and now_ms >= self._rebirth_at_ms:
            self._rebirth_at_ms = None
            out.append(self._birth(up=True))
        for pending in list(self.commands.values()):
            out += self._tick_command(pending, now_ms)
        return out

    def goodbye(self, now_ms: int) -> list[Output]:
        """A clean stop ends the leases and says that the station is gone."""
        if not self.connected:
            return []
        ends: list[Output] = [fog.registration(now_ms, lease_s=0) for fog in self.fogs.values() if fog.registered]
        return [*ends, self._birth(up=False)]

    def _on_fog_message(self, fog: FogView, topic: Any, message: Inbound, now_ms: int) -> list[Output]:
        if isinstance(topic, DroneTopic) and topic.kind == "state":
            return [*fog.on_state(topic.drone, decode_state(topic.name, message.payload, relayed=True), now_ms)]
        if isinstance(topic, DroneTopic) and topic.kind == "reachable":
            return [*fog.on_record(topic.drone, decode(DroneRecord, message.payload), now_ms)]
        if isinstance(topic, DroneTopic) and topic.kind == "commands_result":
            return self._on_result(fog, topic.drone, decode(ResultMessage, message.payload), now_ms)
        if isinstance(topic, FogTopic) and topic.kind == "commands_result":
            return self._on_fog_result(fog, decode(FogResultMessage, message.payload), now_ms)
        if isinstance(topic, FogTopic) and topic.kind == "states":
            pairs = states_of(decode(FogBundle, message.payload))
            return [event for drone, state in pairs for event in fog.on_state(drone, state, now_ms)]
        if isinstance(topic, FogTopic) and topic.kind == "QoDS":
            return [*fog.on_qods(decode(QodsMessage, message.payload))]
        if isinstance(topic, FogTopic) and topic.kind == "PSMI":
            return self._on_psmi(fog, decode(PsmiMessage, message.payload), now_ms)
        if isinstance(topic, FogTopic) and topic.kind == "clock":
            events, confirmed = fog.on_beacon(decode(BeaconMessage, message.payload), now_ms)
            return [*events, *(self._ask_again(fog.number) if confirmed else [])]
        if isinstance(topic, FogTopic) and topic.kind == "reachable":
            effects, events = fog.on_presence(decode(FogPresence, message.payload), now_ms)
            return [*effects, *events]
        raise PayloadError(f"topic {message.topic!r}: not for a ground station", "topic")

    def _ask_again(self, fog_number: int) -> list[Output]:
        """After a lost connection the same bytes again: a duplicate is answered, not executed."""
        return [p.publish for p in self.commands.values() if p.fog == fog_number and p.is_open]

    def _on_result(self, fog: FogView, drone: int, result: ResultMessage, now_ms: int) -> list[Output]:
        pending = self.commands.get(result.id)
        if pending is None or pending.fog != fog.number:
            return []  # another station's, or one that was forgotten
        if pending.drone is None and pending.command.name in SELECTABLE and drone not in (pending.roster or ()):
            pending.roster = (*(pending.roster or ()), drone)  # chosen by PSMI, whose list may have been lost
        if pending.roster is not None and drone not in pending.roster:
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
        )
        return self._say(pending, outcome, now_ms)

    def _say(self, pending: Pending, outcome: Outcome, now_ms: int) -> list[Output]:
        """Pass on a word once: one last word for each drone, and at most one truth after an unconfirmed."""
        assert outcome.drone is not None
        before = pending.words.get(outcome.drone)
        if before is None or not before.is_last:
            if before is outcome.word and outcome.percent is None:
                return []
            pending.words[outcome.drone] = outcome.word
            pending.retry = Retry.after_word(self.settings.qos, now_ms)
            if outcome.word is Word.UNCONFIRMED:
                pending.unconfirmed_here.add(outcome.drone)
            return [Outcome(**{**vars(outcome), "settled": False})]
        if outcome.drone in pending.unconfirmed_here and outcome.word.is_last and outcome.word is not before:
            pending.unconfirmed_here.discard(outcome.drone)
            pending.words[outcome.drone] = outcome.word
            return [Outcome(**{**vars(outcome), "settled": True})]
        return []

    def _on_psmi(self, fog: FogView, message: PsmiMessage, now_ms: int) -> list[Output]:
        pending = self.commands.get(message.id)
        if pending is None or pending.fog != fog.number:
            return []  # another station's
        if message.hold_until_ms is not None or message.chosen is None:
            pending.retry = None
        elif message.chosen not in (pending.roster or ()):
            pending.roster = (*(pending.roster or ()), message.chosen)
        if message.hold_until_ms is not None:
            pending.denied = True  # an offer is answered by its list: nothing flies by it
        return [PsmiList(fog.number, message.id, message.listed, message.left_out, message.chosen)]

    def _on_fog_result(self, fog: FogView, result: FogResultMessage, now_ms: int) -> list[Output]:
        pending = self.commands.get(result.id)
        if pending is None or pending.fog != fog.number or pending.drone is not None or not pending.is_open:
            return []
        if result.denied is not None:
            if pending.roster is not None and not pending.choosing:
                return []
            pending.denied = True
            return [Outcome(pending.id, fog.number, None, pending.command.name, Word.DENIED, result.denied)]
        if pending.roster is None and result.roster is not None:
            pending.roster = tuple(entry.drone for entry in result.roster)
        return []

    def _tick_command(self, pending: Pending, now_ms: int) -> list[Output]:
        if not pending.is_open:
            if now_ms > pending.close_at_ms + KEEP_MS:
                del self.commands[pending.id]
            return []
        if now_ms > pending.close_at_ms:
            return self._give_up(pending, now_ms)
        fog = self.fogs[pending.fog]
        if pending.retry is not None and fog.registered and pending.retry.is_due(now_ms):
            return [pending.publish]
        return []

    def _give_up(self, pending: Pending, now_ms: int) -> list[Output]:
        name = pending.command.name
        if pending.roster is None:
            pending.denied = True
            return [Outcome(pending.id, pending.fog, None, name, Word.UNCONFIRMED, "no_roster")]
        out: list[Output] = []
        for drone in pending.open_drones():
            outcome = Outcome(pending.id, pending.fog, drone, name, Word.UNCONFIRMED)
            out += self._say(pending, outcome, now_ms)
        return out

    def _on_own_presence(self, presence: Presence, now_ms: int) -> list[Output]:
        if self.connected and (presence.session != self.session or not presence.up):
            self._rebirth_at_ms = now_ms + REBIRTH_MS
        return []

    def _subscribe(self, fog: FogView) -> Subscribe:
        return Subscribe(LINK, fog.topics.station_filters(), ref=fog.number)

    def _presence(self, up: bool) -> bytes:
        return encode(Presence(session=self.session, up=up), self.settings.encoding)

    def _birth(self, up: bool) -> Publish:
        return Publish(LINK, self._presence_topic, self._presence(up), qos=1, retain=True)
