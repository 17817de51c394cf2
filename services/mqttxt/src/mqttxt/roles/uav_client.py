"""The UAV client: the MAVLink <-> MQTT interpreter on the drone, as a state machine (docs/protocol.md)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..clock import MAX_TTL_MS, stamp
from ..dialect.vehicle import Vehicle
from ..errors import PayloadError
from ..messages import (
    BeaconMessage,
    By,
    CommandId,
    CommandMessage,
    DroneLease,
    Presence,
    ResultMessage,
    Word,
)
from ..states import Policy, Throttle
from ..topics import DroneTopic, FogSide
from ..wire.codec import decode, encode
from ..wire.identify import identify
from ..wire.states import StampedState, encode_state
from .effects import Effect, Inbound, Journal, Log, Publish, Stop, Subscribe, Transmit, Will
from .enquiries import Enquiries
from .executor import Executor, Output, Said
from .ledger import Admission, Ledger
from .settings import NO_MATCHING_SUBSCRIBERS, Settings

LINK = "fog"
NO_DEADLINE = "no_deadline"
MAV_HEARTBEAT_MS = 1000
REBIRTH_MS = 1000
_KEPT_BACK_MS = 1000
"""How long a result waits before it is published again, where nobody was there to get it."""


@dataclass
class Answers:
    """What was said of a command: its name for the topic, the words, and which last word was acknowledged."""

    name: str
    words: list[ResultMessage] = field(default_factory=list)
    delivered: bool = False

    @property
    def last(self) -> ResultMessage | None:
        return self.words[-1] if self.words and self.words[-1].word.is_last else None


@dataclass(frozen=True)
class Unfinished:
    """What a journal tells of an earlier session: an id that was open, or a last word that nobody acknowledged."""

    id: CommandId
    command: str
    word: Word | None = None
    reason: str | None = None


class UavClient:
    """One drone's side of the fog link. Times are milliseconds of the session clock."""

    def __init__(
        self,
        drone: int,
        session: int,
        settings: Settings,
        topics: FogSide | None = None,
        policies: dict[str, Policy] | None = None,
        unfinished: list[Unfinished] | None = None,
    ) -> None:
        self.drone = drone
        self.session = session
        self.settings = settings
        self.topics = topics or FogSide()
        self.vehicle = Vehicle(drone)
        self.executor = Executor(self.vehicle)
        self.ledger: Ledger[Answers] = Ledger()
        self.connected = False
        self.born = False
        self._throttle = Throttle(policies)
        self._enquiries = Enquiries(self.vehicle)
        self._awaited_subacks = 0
        self._highest_started: dict[int, int] = {}
        self._next_beacon_ms = 0
        self._next_mav_heartbeat_ms = 0
        self._rebirth_at_ms: int | None = None
        self._republish_at_ms: int | None = None
        self._restored: list[Unfinished] = list(unfinished or [])
        for left in self._restored:
            entry = self.ledger.enter(left.id, None, Answers(left.command), 0)
            self.ledger.close(entry, 0)

    def will(self) -> Will:
        """The will of the connection to the fog broker."""
        return Will(self.topics.reachable(self.drone), self._presence(up=False))

    def is_ready(self, now_ms: int) -> bool:
        """Whether the drone has a session with its broker and a heartbeat from its autopilot."""
        return self.born and self.vehicle.is_alive(now_ms)

    def on_connected(self, now_ms: int) -> list[Effect]:
        self.connected = True
        self._awaited_subacks = 2
        commands = Subscribe(LINK, (self.topics.commands(self.drone),), live_only=True)
        others = (self.topics.init_connect(self.drone), self.topics.reachable(self.drone))
        return [commands, Subscribe(LINK, others)]

    def on_disconnected(self, now_ms: int) -> list[Effect]:
        self.connected = self.born = False
        return []

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Effect]:
        """Commands can be heard from now on: say so, then everything that may not have been heard before."""
        self._awaited_subacks -= 1
        if self._awaited_subacks != 0:
            return []
        self.born = True
        self._throttle.forget_published()
        out: list[Effect] = [self._birth(), self._beacon(now_ms)]
        return out + self._close_restored(now_ms) + self._republish()

    def on_message(self, message: Inbound, now_ms: int) -> list[Effect]:
        """A message from the fog broker."""
        try:
            topic = self.topics.parse(message.topic)
            if topic.drone != self.drone:
                raise PayloadError(f"topic {message.topic!r}: not drone {self.drone}'s", "topic")
            if topic.kind == "commands":
                return self._on_command_payload(message, now_ms)
            return self._on_other(topic, message, now_ms)
        except PayloadError as error:
            return [Log(error.kind, f"{message.topic}: {error}")]

    def on_published(self, ref: Any, code: int, now_ms: int) -> list[Effect]:
        """A QoS 1 publish with `ref` was acknowledged with an MQTT reason code."""
        entry = self.ledger.get(ref)
        if entry is None or entry.record.delivered or entry.record.last is None:
            return []
        if code == NO_MATCHING_SUBSCRIBERS or code >= 0x80:
            self._republish_at_ms = now_ms + _KEPT_BACK_MS
            return []
        entry.record.delivered = True
        return [Journal(entry.id, entry.record.name, done=True)]

    def on_mavlink(self, message: Any, now_ms: int) -> list[Effect]:
        """A message from the autopilot's link."""
        for state in self.vehicle.update(message, now_ms):
            self._throttle.update(state)
        return self._carry_out(self.executor.on_message(message, now_ms), now_ms)

    def on_transmitted(self, ref: Any, now_ms: int) -> list[Effect]:
        return self._carry_out(self.executor.on_transmitted(ref, now_ms), now_ms)

    def on_refused(self, ref: Any, late: bool, now_ms: int) -> list[Effect]:
        return self._carry_out(self.executor.on_refused(ref, late, now_ms), now_ms)

    def tick(self, now_ms: int) -> list[Effect]:
        """Everything that is due by time; to be called at least ten times a second."""
        out = self._carry_out(self.executor.tick(now_ms), now_ms)
        if now_ms >= self._next_mav_heartbeat_ms:
            self._next_mav_heartbeat_ms = now_ms + MAV_HEARTBEAT_MS
            out.append(Transmit(_onboard_heartbeat()))
        out += [Transmit(question) for question in self._enquiries.due(now_ms)]
        if not self.born:
            return out
        if now_ms >= self._next_beacon_ms:
            out.append(self._beacon(now_ms))
        if self._rebirth_at_ms is not None and now_ms >= self._rebirth_at_ms:
            self._rebirth_at_ms = None
            out.append(self._birth())
        if self._republish_at_ms is not None and now_ms >= self._republish_at_ms:
            self._republish_at_ms = None
            out += self._republish()
        return out + self._publish_states(now_ms)

    def goodbye(self, now_ms: int) -> list[Effect]:
        """A clean stop says that the drone is no longer reachable."""
        self.born = False
        return [self._publish_presence(up=False)] if self.connected else []

    def _on_other(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        if topic.kind == "reachable":
            seen = decode(Presence, message.payload)
            if self.born and (seen.session != self.session or not seen.up):
                self._rebirth_at_ms = now_ms + REBIRTH_MS
            return []
        if topic.kind == "init_connect":
            lease = decode(DroneLease, message.payload)
            if lease.drone_session != self.session:
                return []
            if not lease.bound:
                return [Stop(f"refused: another live UAV client is drone {self.drone} already")]
            return [self._beacon(now_ms, lease.nonce)]
        raise PayloadError(f"topic {message.topic!r}: not a UAV client's", "topic")

    def _on_command_payload(self, message: Inbound, now_ms: int) -> list[Effect]:
        try:
            command = decode(CommandMessage, message.payload)
        except PayloadError as error:
            out: list[Effect] = [Log(error.kind, f"{message.topic}: {error}")]
            known = identify(message.payload)
            if known is not None and self.ledger.get(known) is None:
                denial = self._result(Said(known, Word.DENIED, str(error)), now_ms)
                out.append(self._publish_result("malformed", denial, kept=False))
            return out
        return self._on_command(command, message.retain, now_ms)

    def _on_command(self, command: CommandMessage, retained: bool, now_ms: int) -> list[Effect]:
        deadline_ms = command.deadline_ms
        if command.executor_session != self.session or deadline_ms is None:
            deadline_ms = None
        known_until_ms = min(deadline_ms or now_ms, now_ms + MAX_TTL_MS)
        verdict = self.ledger.examine(command.id, command.command, known_until_ms, now_ms)
        if verdict is Admission.DUPLICATE:
            entry = self.ledger.get(command.id)
            assert entry is not None
            return self._answer(entry.record)
        if verdict in (Admission.CONFLICT, Admission.FULL):
            reason = "id_conflict" if verdict is Admission.CONFLICT else "ledger_full"
            denial = self._result(Said(command.id, Word.DENIED, reason), now_ms)
            return [self._publish_result(command.command.name, denial, kept=False)]
        self.ledger.enter(command.id, command.command, Answers(command.command.name), known_until_ms)
        refusal = self._refusal(command, deadline_ms, retained, now_ms)
        if refusal is not None:
            return self._carry_out([refusal], now_ms)
        assert deadline_ms is not None
        self._highest_started[command.gs_session] = command.seq
        limit_ms = round(command.limit_s * 1000)
        started = self.executor.start(command.id, command.command, deadline_ms, limit_ms, now_ms)
        return [Journal(command.id, command.command.name), *self._carry_out(started, now_ms)]

    def _refusal(self, command: CommandMessage, deadline_ms: int | None, retained: bool, now_ms: int) -> Said | None:
        """Why a new command is not started, None when it is."""
        if retained:
            return Said(command.id, Word.DENIED, "retained")
        if deadline_ms is None:
            return Said(command.id, Word.DENIED, NO_DEADLINE)
        if deadline_ms > now_ms + MAX_TTL_MS:
            return Said(command.id, Word.DENIED, "deadline_too_far")
        if now_ms > deadline_ms:
            return Said(command.id, Word.EXPIRED)
        if command.seq < self._highest_started.get(command.gs_session, -1):
            return Said(command.id, Word.OVERTAKEN)
        return None

    def _carry_out(self, outputs: list[Output], now_ms: int) -> list[Effect]:
        """Effects as they are; words become results, recorded in ledger and journal before they leave."""
        out: list[Effect] = []
        for output in outputs:
            if not isinstance(output, Said):
                out.append(output)
                continue
            entry = self.ledger.get(output.id)
            assert entry is not None
            result = self._result(output, now_ms)
            entry.record.words.append(result)
            if output.word.is_last:
                self.ledger.close(entry, now_ms)
                out.append(Journal(entry.id, entry.record.name, output.word, output.reason))
            out += self._answer(entry.record)
        return out

    def _result(self, said: Said, now_ms: int) -> ResultMessage:
        return ResultMessage(
            gs_session=said.id.gs_session,
            seq=said.id.seq,
            session=self.session,
            stamp=stamp(now_ms),
            word=said.word,
            reason=said.reason,
            percent=said.percent,
            late_ms=said.late_ms,
            by=By(gs_session=said.by.gs_session, seq=said.by.seq) if said.by is not None else None,
            beacon=self._beacon_message(now_ms) if said.reason == NO_DEADLINE else None,
        )

    def _answer(self, record: Answers) -> list[Effect]:
        """The newest word, while there is somebody to publish it to; without one it will come by itself.

        At QoS 0 nothing acknowledges it: what is lost is asked for again.
        """
        if not record.words or not self.born:
            return []
        newest = record.words[-1]
        out: list[Effect] = [self._publish_result(record.name, newest)]
        if self.settings.qos == 0 and newest.word.is_last and not record.delivered:
            record.delivered = True
            out.append(Journal(newest.id, record.name, done=True))
        return out

    def _republish(self) -> list[Effect]:
        """The newest words whose delivery was not acknowledged."""
        records = [entry.record for entry in self.ledger.entries()]
        return [effect for record in records if not record.delivered for effect in self._answer(record)]

    def _close_restored(self, now_ms: int) -> list[Effect]:
        """Ids that an earlier session left: nobody knows what became of the open ones."""
        out: list[Effect] = []
        for left in self._restored:
            entry = self.ledger.get(left.id)
            assert entry is not None
            word, reason = (left.word, left.reason) if left.word else (Word.UNCONFIRMED, "restarted")
            entry.record.words.append(self._result(Said(left.id, word, reason), now_ms))
            out.append(Journal(left.id, left.command, word, reason))
        self._restored.clear()
        return out

    def _publish_result(self, name: str, result: ResultMessage, kept: bool = True) -> Publish:
        """Only the acknowledgement of a last word that the ledger keeps ends its repetition."""
        topic = self.topics.commands_result(self.drone, name)
        ref = result.id if kept and result.word.is_last else None
        return self._publish(topic, encode(result, self.settings.encoding), ref=ref)

    def _publish(self, topic: str, payload: bytes, ref: CommandId | None = None) -> Publish:
        return Publish(LINK, topic, payload, self.settings.qos, ref=ref)

    def _publish_states(self, now_ms: int) -> list[Effect]:
        out: list[Effect] = []
        for state in self._throttle.due(now_ms):
            stamped = StampedState(state, stamp(now_ms))
            try:
                payload = encode_state(stamped, self.settings.encoding)
            except PayloadError as error:
                out.append(Log("autopilot_value", f"{state.name}: {error}"))
                continue
            out.append(Publish(LINK, self.topics.state(self.drone, state.name), payload, qos=0))
        return out

    def _presence(self, up: bool) -> bytes:
        return encode(Presence(session=self.session, up=up), self.settings.encoding)

    def _publish_presence(self, up: bool) -> Publish:
        return Publish(LINK, self.topics.reachable(self.drone), self._presence(up), qos=1, retain=True)

    def _birth(self) -> Publish:
        return self._publish_presence(up=True)

    def _beacon_message(self, now_ms: int, nonce: int | None = None) -> BeaconMessage:
        held_ms = 0 if nonce is not None else None
        return BeaconMessage(session=self.session, now_ms=now_ms, nonce=nonce, held_ms=held_ms)

    def _beacon(self, now_ms: int, nonce: int | None = None) -> Publish:
        self._next_beacon_ms = now_ms + self.settings.beacon_interval_ms
        payload = encode(self._beacon_message(now_ms, nonce), self.settings.encoding)
        return Publish(LINK, self.topics.clock(self.drone), payload, qos=0)


def _onboard_heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
