"""The UAV client's end of the air leg: a state machine that is fed datagrams and times, and reports by callbacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Protocol

from ....protocol.cbor import MAX_PAYLOAD
from ...effects import Inbound, Publish, Will
from ...effects import Subscribe as SubscribeEffect
from ..client import KEEPALIVE_S
from ..round_trip import RoundTrip
from ..subscriptions import UNSPECIFIED
from . import codec, packets
from .packets import PREDEFINED, Message, Packet, Subscribe
from .sender import GIVE_UP_S, LARGEST_DATAGRAM, Receiver, Sender, repeat_after_s
from .together import AirMessage, Unpacker
from .topic_ids import TOGETHER, TopicIds, Travel

QUIET_S = 5.0
"""After this long without a datagram from the gateway the client sends a PINGREQ (R20.9)."""
CONFIRM_S = 1.5
"""A state that no newer one has followed within this time is sent once more, at QoS 1 (R20.4)."""
_UNREADABLE = 0x99


class ClientEvents(Protocol):
    """The callbacks of an `SnClient`."""

    def on_connack(self, code: int) -> None: ...
    def on_message(self, message: Inbound) -> None: ...
    def on_ended(self) -> None:
        """The gateway has ended the connection, or no longer answers."""
        ...

    def count(self, kind: str, detail: str) -> None: ...


@dataclass
class _Newest:
    told: AirMessage
    confirm_s: float


class SnClient:
    """One connection to a gateway, from CONNECT to its end. `send` sends a datagram; times are seconds of one clock."""

    def __init__(
        self, client_id: str, will: Will | None, ids: TopicIds, send: Callable[[bytes], None], events: ClientEvents
    ) -> None:
        self.round_trip = RoundTrip()
        self.is_up = self.has_ended = False
        self._client_id = client_id
        self._will = will
        self._ids = ids
        self._send_datagram = send
        self._events = events
        self._step: Packet | None = None
        """The packet of the handshake, or the DISCONNECT, that is repeated until it is answered."""
        self._step_s, self._step_times = 0.0, 0
        self._sender = Sender(self._send, ids, self.round_trip, self._id_of, together=True)
        self._receiver = Receiver()
        self._unpacker = Unpacker(ids)
        self._newest: dict[str, _Newest] = {}
        self._last_in_s = 0.0
        self._pinged_s: float | None = None
        self._ping_sent_s, self._ping_times = 0.0, 0

    @property
    def is_settled(self) -> bool:
        """Whether all messages that must arrive have been acknowledged."""
        return self._sender.is_idle

    def connect(self, now_s: float) -> None:
        self._last_in_s = now_s
        has_will = self._will is not None
        self._take_step(packets.Connect(self._client_id, KEEPALIVE_S, has_will), now_s)

    def publish(self, effect: Publish, now_s: float, done: Callable[[int], None] | None = None) -> None:
        """Send a message as its topic travels (R20.4); `done` gets the MQTT 5 reason code of one that travels surely.

        MQTT-SN's own return codes, which mean that the message was not accepted, become 0x80.
        """
        told = AirMessage(effect.topic, effect.payload, effect.qos, effect.retain)
        travel = self._ids.travel(effect.topic)
        size = codec.size_of_publish(effect.payload)
        found = self._id_of(effect.topic)
        if len(effect.payload) > MAX_PAYLOAD:
            self._events.count("too_long_for_broker", f"{effect.topic}: {len(effect.payload)} bytes")
        elif travel is Travel.SURELY or found is None or size > LARGEST_DATAGRAM:
            own = partial(_in_mqtt_5, done) if done is not None else None
            self._tell(told, now_s, own)
        else:
            if travel is Travel.NEWEST:
                self._sender.forget(effect.topic)
                self._newest[effect.topic] = _Newest(told, now_s + CONFIRM_S)
            self._send(Message(found[0], effect.payload, retain=effect.retain))

    def subscribe(self, effect: SubscribeEffect, now_s: float, done: Callable[[list[int]], None]) -> None:
        """Subscribe to each of the filters; `done` gets the return codes, in the order of the filters."""
        codes: list[int] = []

        def on_code(code: int) -> None:
            codes.append(code)
            if len(codes) == len(effect.filters):
                done(codes)

        for topic in effect.filters:
            self._sender.ask(Subscribe(0, self._filter(topic), live_only=effect.live_only), now_s, on_code)

    def unsubscribe(self, filters: tuple[str, ...], now_s: float) -> None:
        for topic in filters:
            self._sender.ask(packets.Unsubscribe(0, self._filter(topic)), now_s, lambda _code: None)

    def ping(self, now_s: float) -> None:
        """Send a PINGREQ, unless one is unanswered."""
        if self.is_up and self._pinged_s is None:
            self._pinged_s, self._ping_sent_s, self._ping_times = now_s, now_s, 1
            self._send(packets.Pingreq())

    def usual_s(self, now_s: float) -> float:
        """The usual upper bound of the gateway's round trip, s; infinite if an answer is overdue."""
        return self.round_trip.usual_s(now_s - self._pinged_s if self._pinged_s is not None else 0.0)

    def disconnect(self, now_s: float, *, with_will: bool) -> None:
        """Send DISCONNECT, and repeat it until the gateway has answered."""
        if not self.has_ended:
            self._take_step(packets.Disconnect(1 if with_will else None), now_s)

    def received(self, datagram: bytes, now_s: float) -> None:
        """A datagram arrived from the gateway's address; one that is no packet is counted and dropped."""
        try:
            packet = codec.decode(datagram)
        except ValueError as error:
            self._events.count("air_datagram", str(error))
            return
        if self.has_ended:
            return
        self._last_in_s = now_s
        self._on_packet(packet, now_s)

    def tick(self, now_s: float) -> None:
        """Repeat due packets, send states once more, ping the gateway; to be called at `due_s`."""
        if self.has_ended:
            return
        if self._step is not None and now_s >= self._step_due_s():
            self._step_s, self._step_times = now_s, self._step_times + 1
            self._send(self._step)
        if not self.is_up:
            return
        for topic in [topic for topic, newest in self._newest.items() if now_s >= newest.confirm_s]:
            self._tell(self._newest.pop(topic).told, now_s, None, topic)
        if self._pinged_s is None and now_s - self._last_in_s >= QUIET_S:
            self.ping(now_s)
        elif self._pinged_s is not None and now_s >= self._ping_due_s():
            self._ping_sent_s, self._ping_times = now_s, self._ping_times + 1
            self._send(packets.Pingreq())
        self._sender.tick(now_s)
        if self._sender.is_lost(now_s) or now_s - self._last_in_s >= GIVE_UP_S:
            self._end()

    def due_s(self) -> float:
        """When to call `tick` next."""
        step_s = self._step_due_s() if self._step is not None else inf
        if not self.is_up:
            return step_s
        confirm_s = min((newest.confirm_s for newest in self._newest.values()), default=inf)
        ping_s = self._last_in_s + QUIET_S if self._pinged_s is None else self._ping_due_s()
        return min(step_s, confirm_s, ping_s, self._sender.due_s(), self._last_in_s + GIVE_UP_S)

    def _on_packet(self, packet: Packet, now_s: float) -> None:
        match packet:
            case packets.WillTopicReq() if isinstance(self._step, packets.Connect) and self._will is not None:
                self._answered_step(now_s)
                self._take_step(packets.WillTopic(self._will.topic), now_s)
            case packets.WillMsgReq() if isinstance(self._step, packets.WillTopic) and self._will is not None:
                self._answered_step(now_s)
                self._take_step(packets.WillMsg(self._will.payload), now_s)
            case packets.Connack() if not (self.is_up or isinstance(self._step, packets.Disconnect)):
                self._step = None
                self.is_up = packet.code == 0
                if self.is_up:  # from now on the gateway may send messages together
                    self._sender.ask(Subscribe(0, TOGETHER), now_s, self._on_together)
                self._events.on_connack(packet.code)
            case packets.Puback() | packets.Suback() | packets.Unsuback():
                self._sender.on_answer(packet, now_s)
            case Message() if self.is_up:
                self._on_told(packet)
            case packets.Pingreq():
                if self.is_up:  # else the ping is for an earlier client of this port
                    self._send(packets.Pingresp())
            case packets.Pingresp():
                if self._pinged_s is not None and self._ping_times == 1:
                    self.round_trip.took(now_s - self._pinged_s)
                self._pinged_s = None
            case packets.Disconnect():
                self._end()
            case packets.WillTopicReq() | packets.WillMsgReq() | packets.Connack():
                pass  # a repetition
            case _:
                self._events.count("air_packet", f"{type(packet).__name__}: not expected now")

    def _on_told(self, message: Message) -> None:
        is_new = message.qos == 0 or self._receiver.is_new(message.msg_id)
        if not is_new:
            if self._receiver.is_last(message.msg_id):
                self._send(packets.Puback(message.topic_id, message.msg_id))
            return
        topic = self._ids.topic_of(message.topic_id) if message.id_type == PREDEFINED else None
        code, told = 0, []
        if message.topic_id == TOGETHER and message.qos == 1:
            try:
                told = self._unpacker.take(message.payload)
            except ValueError as error:
                self._events.count("air_datagram", str(error))
                code = _UNREADABLE
        elif topic is None:
            code = packets.INVALID_TOPIC
        else:
            told = [AirMessage(topic, message.payload, message.qos, message.retain)]
        if message.qos:
            self._send(packets.Puback(message.topic_id, message.msg_id, code))
        for each in told:
            self._events.on_message(Inbound(each.topic, each.payload, each.qos, each.retain))
        if code == _UNREADABLE:
            self._end()

    def _on_together(self, code: int) -> None:
        if code != 0:
            self._events.count("air_together", "the gateway takes no messages together: expected an activator's")
            self._end()

    def _tell(self, told: AirMessage, now_s: float, done: Callable[[int], None] | None, key: str | None = None) -> None:
        if not self._sender.tell(told, now_s, done, key):
            self._events.count("held_up", f"{told.topic}: the gateway acknowledges nothing")

    def _filter(self, topic: str) -> int | str:
        """A topic's id, or its name if it has none."""
        known = self._ids.id_of(topic)
        return topic if known is None else known

    def _id_of(self, topic: str) -> tuple[int, int] | None:
        found = self._ids.id_of(topic)
        return (found, PREDEFINED) if found is not None else None

    def _take_step(self, packet: Packet, now_s: float) -> None:
        self._step, self._step_s, self._step_times = packet, now_s, 1
        self._send(packet)

    def _answered_step(self, now_s: float) -> None:
        if self._step_times == 1:
            self.round_trip.took(now_s - self._step_s)

    def _step_due_s(self) -> float:
        return self._step_s + repeat_after_s(self.round_trip, self._step_times)

    def _ping_due_s(self) -> float:
        return self._ping_sent_s + repeat_after_s(self.round_trip, self._ping_times)

    def _send(self, packet: Packet) -> None:
        self._send_datagram(codec.encode(packet))

    def _end(self) -> None:
        if not self.has_ended:
            self.has_ended, self.is_up, self._step = True, False, None
            self._events.on_ended()


def _in_mqtt_5(done: Callable[[int], None], code: int) -> None:
    done(UNSPECIFIED if 0 < code < packets.FIRST_OF_MQTT_5 else code)
