"""One UAV client at its gateway: a state machine between the client's datagrams and a connection to the broker."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from enum import Enum, auto
from math import inf
from typing import Protocol

from ...effects import Inbound, Will
from ..client import KEEPALIVE_S
from ..round_trip import RoundTrip
from . import codec, packets
from .address_proof import AddressProof
from .challenge import Challenge
from .own_topics import OwnTopics
from .packets import PREDEFINED, Message, Packet
from .sender import LARGEST_DATAGRAM, MOST_IDS, Receiver, Sender
from .together import AirMessage, Unpacker
from .topic_ids import TOGETHER, TopicIds, Travel

GREETING_S = 5.0
"""How long a client may take for its will, and for its first packet after CONNACK."""
OPENING_S = 20.0
"""How long after its CONNECT a client without a connection to the broker is kept."""
LINGER_S = 5.0
"""How long after its DISCONNECT a client is answered when it repeats that."""
_REFUSED, _TOO_MUCH = 0x87, 0x97
"""MQTT 5's reason codes "not authorized" and "quota exceeded"."""
_Asked = Message | packets.Register | packets.Subscribe | packets.Unsubscribe
_Answer = packets.Puback | packets.Regack | packets.Suback | packets.Unsuback


class BrokerSide(Protocol):
    """The client's connection to the broker, which reports to the methods of `AirClient`."""

    def open(self, client_id: str, will: Will | None) -> None: ...
    def publish(self, told: AirMessage, ref: Hashable) -> None: ...
    def subscribe(self, topic: str, live_only: bool, ref: Hashable) -> None: ...
    def unsubscribe(self, topic: str) -> None: ...
    def close(self, *, with_will: bool) -> None: ...


class Stage(Enum):
    WILL_TOPIC = auto()
    WILL = auto()
    OPENING = auto()
    UP = auto()
    LEFT = auto()
    GONE = auto()


@dataclass
class _Awaited:
    """A PUBLISH that awaits the broker: how many PUBACKs are `missing`, and the worst code so far."""

    topic_id: int
    msg_id: int
    missing: int
    code: int


class AirClient:
    """One client at one address, from its CONNECT to its end. Times are seconds of one clock.

    `claim` returns whether the client may connect with its id and drone, `is_newer_list` whether to pass a revocation
    list on, `takes_birth` whether to pass on a birth or will of so many bytes. The client's drone is the first one that
    its will or a topic names.
    """

    def __init__(
        self,
        connect: packets.Connect,
        ids: TopicIds,
        send: Callable[[bytes], None],
        broker: BrokerSide,
        claim: Callable[[AirClient, float], bool],
        is_newer_list: Callable[[bytes, float], bool],
        takes_birth: Callable[[int | None, int, float], bool],
        count: Callable[[str, str], None],
        now_s: float,
    ) -> None:
        self.client_id = connect.client_id
        self.stage = Stage.WILL_TOPIC if connect.has_will else Stage.OPENING
        self.drone: int | None = None
        self.published = 0
        """How many messages it has published."""
        self._challenge = Challenge()
        self._keepalive_s = min(connect.duration_s or KEEPALIVE_S, KEEPALIVE_S)
        self._ids = ids
        self._send_datagram = send
        self._broker = broker
        self._claim = claim
        self._is_newer_list = is_newer_list
        self._takes_birth = takes_birth
        self._count = count
        self._will_topic = ""
        self._since_s = self._last_in_s = now_s
        self.is_confirmed = False
        """Whether it has sent a packet other than WILLMSG or DISCONNECT since it is connected."""
        self._address = AddressProof()
        round_trip = RoundTrip()
        last_id = secrets.randbelow(MOST_IDS)
        self._topics = OwnTopics(ids)
        self._sender = Sender(self._send, ids, round_trip, self._topics.id_of, together=False, last_id=last_id)
        self._receiver = Receiver()
        self._unpacker = Unpacker(ids)
        self._awaited: _Awaited | None = None
        self._asking: packets.Subscribe | None = None
        self._last_answer: _Answer | None = None
        self._may_take_leave_again = True

    def start(self) -> None:
        """Answer the CONNECT."""
        if self.stage is Stage.OPENING:
            self._open(None)
        else:
            self._send(packets.WillTopicReq())

    @property
    def is_there(self) -> bool:
        """Whether it holds its id: it has a connection to the broker, or one is being opened."""
        return self.stage in (Stage.OPENING, Stage.UP)

    def came(self, size: int) -> None:
        """A datagram of `size` bytes arrived from the client's address."""
        self._address.came(size)

    def received(self, packet: Packet, now_s: float) -> None:
        """A packet arrived from the client's address."""
        self._last_in_s = now_s
        self._challenge.answered()
        if self.stage is Stage.UP:
            self.is_confirmed = self.is_confirmed or not isinstance(packet, packets.WillMsg | packets.Disconnect)
            self._on_packet(packet, now_s)
        elif self.stage is Stage.LEFT:  # two gateways would go on answering each other
            if not isinstance(packet, packets.Disconnect) or self._may_take_leave_again:
                self._may_take_leave_again = not isinstance(packet, packets.Disconnect)
                self._send(packets.Disconnect())
        elif isinstance(packet, packets.Disconnect):
            self._send(packets.Disconnect())
            self._leave(now_s, with_will=packet.duration_s is not None)
        elif self.stage is Stage.WILL_TOPIC and isinstance(packet, packets.WillTopic):
            self._on_will_topic(packet)
        elif self.stage is Stage.WILL and isinstance(packet, packets.WillMsg):
            self._open(Will(self._will_topic, packet.payload))
        elif self.stage is Stage.WILL and isinstance(packet, packets.WillTopic):
            self._send(packets.WillMsgReq())

    def on_connect_again(self, now_s: float) -> bool:
        """Its CONNECT arrived again; returns whether that is a repetition, which then is answered again."""
        if self.stage is Stage.WILL_TOPIC:
            self._send(packets.WillTopicReq())
        elif self.stage is Stage.WILL:
            self._send(packets.WillMsgReq())
        elif self.stage is Stage.UP and not self.is_confirmed:
            self._send(packets.Connack())
        return not (self.stage in (Stage.LEFT, Stage.GONE) or (self.stage is Stage.UP and self.is_confirmed))

    def ask(self, now_s: float) -> None:
        """Challenge the client, because a newcomer has named its id or drone."""
        if self._challenge.begin(now_s):
            self._send(packets.Pingreq())

    def tick(self, now_s: float) -> None:
        """Repeat due packets, and end the client when its time is over; to be called at `due_s`."""
        if self.stage is Stage.UP:
            self._sender.tick(now_s)
        if self.is_there and self._challenge.asks_again(now_s):
            self._send(packets.Pingreq())
        is_lost = self.stage is Stage.UP and self._sender.is_lost(now_s)
        if now_s < self._over_s() and not is_lost:
            return
        if self.is_there:
            self.end(now_s)
        else:
            self.stage = Stage.GONE

    def due_s(self) -> float:
        """When to call `tick` next."""
        ask_due_s = self._challenge.due_s() if self.is_there else inf
        return min(self._over_s(), ask_due_s, self._sender.due_s() if self.stage is Stage.UP else inf)

    def _over_s(self) -> float:
        """When its stage ends if no further packet arrives: while up, as a broker's keep-alive (MQTT 5.0, 3.1.2.10)."""
        if not self.is_there:
            return self._since_s + (LINGER_S if self.stage is Stage.LEFT else GREETING_S)
        is_up = self.stage is Stage.UP
        lasts_s = self._last_in_s + 1.5 * self._keepalive_s if is_up else self._since_s + OPENING_S
        if is_up and not self.is_confirmed:
            lasts_s = self._since_s + GREETING_S
        return min(lasts_s, self._challenge.over_s())

    def end(self, now_s: float) -> None:
        """Give the client up; the broker publishes its will.

        No DISCONNECT is sent during a challenge: the newcomer with its id may be at the same port.
        """
        if not self._challenge.is_open:
            self._send(packets.Disconnect())
        self._leave(now_s, with_will=True)

    # Reports of the connection to the broker.

    def on_opened(self, code: int, now_s: float) -> None:
        """The broker has answered with `code`, or cannot be reached (CONGESTION)."""
        if self.stage is not Stage.OPENING:
            return
        self.stage, self._since_s = Stage.UP if code == 0 else Stage.GONE, now_s
        self._send(packets.Connack(code))

    def on_ended(self, now_s: float, refused: bool = False) -> None:
        """The broker has ended the connection; `refused`: because of a subscription."""
        if self.stage is Stage.UP:
            if refused and self._asking is not None:
                self._send(packets.Suback(0, self._asking.msg_id, _REFUSED))
            self.end(now_s)

    def on_message(self, message: Inbound, now_s: float) -> None:
        """The broker has delivered a message for the client."""
        if self.stage is not Stage.UP:
            return
        known, told = (
            self._topics.id_of(message.topic),
            AirMessage(message.topic, message.payload, message.qos, message.retain),
        )
        fits = codec.size_of_publish(message.payload) <= LARGEST_DATAGRAM
        if known is not None and fits and self._ids.travel(message.topic) is not Travel.SURELY:
            self._send(Message(known[0], message.payload, known[1], retain=message.retain))
        elif not self._sender.tell(told, now_s):
            self._count("air_held_up", f"{self.client_id}: {message.topic}")

    def on_published(self, ref: Hashable, code: int) -> None:
        """The broker has acknowledged a publish; `ref` is the message id of the client's packet."""
        awaited = self._awaited
        if awaited is not None and awaited.msg_id == ref:
            self._await(_Awaited(awaited.topic_id, awaited.msg_id, awaited.missing - 1, max(awaited.code, code)))

    def on_subscribed(self, ref: Hashable) -> None:
        """The broker has granted the subscription of the packet with the message id `ref`."""
        subscribe = self._asking
        if subscribe is not None and subscribe.msg_id == ref:
            self._asking = None
            self._answer(packets.Suback(self._topics.granted(subscribe.topic), subscribe.msg_id))

    # Packets of a connected client.

    def _on_packet(self, packet: Packet, now_s: float) -> None:
        if isinstance(packet, _Asked) and not (isinstance(packet, Message) and packet.qos == 0):
            if self._awaited is not None or self._asking is not None:
                return
            if not self._receiver.is_new(packet.msg_id):
                if self._last_answer is not None and self._last_answer.msg_id == packet.msg_id:
                    self._send(self._last_answer)
                return
        match packet:
            case Message():
                self._on_told(packet, now_s)
            case packets.Puback():
                is_answer = self._sender.on_answer(packet, now_s)
                if not (is_answer or self._address.is_proven):
                    self._count("air_unproven", f"{self.client_id}: a PUBACK of what was not sent")
                    self.end(now_s)
                self._address.is_proven = is_answer or self._address.is_proven
            case packets.Register():
                self._on_register(packet, now_s)
            case packets.Subscribe():
                self._on_subscribe(packet, now_s)
            case packets.Unsubscribe():
                topic = self._topics.name_of(packet.topic)
                if topic is not None:
                    self._broker.unsubscribe(topic)
                self._answer(packets.Unsuback(packet.msg_id))
            case packets.Pingreq():
                self._send(packets.Pingresp())
            case packets.WillMsg():
                self._send(packets.Connack())
            case packets.Disconnect():
                self._send(packets.Disconnect())
                self._leave(now_s, with_will=packet.duration_s is not None)
            case packets.Pingresp() | packets.Regack():
                pass
            case _:
                self._count("air_packet", f"{self.client_id}: {type(packet).__name__}: not expected now")

    def _on_told(self, message: Message, now_s: float) -> None:
        try:
            told = self._read(message)
        except ValueError as error:
            self._count("air_datagram", f"{self.client_id}: {error}")
            if _is_stream(message):
                self.end(now_s)
            elif message.qos:
                self._answer(packets.Puback(message.topic_id, message.msg_id, packets.INVALID_TOPIC))
            return
        for each in told:
            may_be_retained = not each.retain or self._ids.may_retain(each.topic)
            if not (self._may(self._ids.may_say, each.topic, now_s) and may_be_retained):
                self._count("air_topic", f"{self.client_id}: {each.topic}: not one that its drone publishes")
                if self.stage is Stage.UP and message.qos:
                    self._answer(packets.Puback(message.topic_id, message.msg_id, packets.INVALID_TOPIC))
                if self.stage is Stage.UP and _is_stream(message):
                    self.end(now_s)
                return
        self.published += len(told)
        refusals = [self._refusal(each, now_s) for each in told]
        passed_on = [each for each, refusal in zip(told, refusals, strict=True) if refusal is None]
        if message.qos:
            code = max((refusal for refusal in refusals if refusal is not None), default=0)
            self._await(_Awaited(message.topic_id, message.msg_id, sum(each.qos > 0 for each in passed_on), code))
        for each in passed_on:
            self._broker.publish(each, message.msg_id if each.qos else None)

    def _read(self, message: Message) -> list[AirMessage]:
        """The messages that a PUBLISH carries or completes; raises ValueError."""
        if _is_stream(message):
            if message.qos == 0:
                raise ValueError("messages together at QoS 0; expected QoS 1")
            return self._unpacker.take(message.payload)
        topic = self._topics.name_of(message.topic_id, message.id_type)
        if topic is None:
            raise ValueError(f"topic id {message.topic_id}: known to nobody")
        return [AirMessage(topic, message.payload, message.qos, message.retain)]

    def _refusal(self, told: AirMessage, now_s: float) -> int | None:
        """The return code of a list or birth that is not passed on, else None: other nodes receive these too."""
        if self._ids.is_list(told.topic) and not self._is_newer_list(told.payload, now_s):
            self._count("air_list", f"{self.client_id}: {told.topic}: no newer list of the fleet")
            return 0
        if self._ids.is_birth(told.topic) and not self._takes_birth(self.drone, len(told.payload), now_s):
            self._count("air_flood", f"{self.client_id}: {told.topic}")
            return _TOO_MUCH
        return None

    def _await(self, awaited: _Awaited) -> None:
        """Send the PUBACK once the broker has acknowledged all its messages."""
        if awaited.missing > 0:
            self._awaited = awaited
            return
        self._awaited = None
        self._answer(packets.Puback(awaited.topic_id, awaited.msg_id, awaited.code))

    def _on_register(self, packet: packets.Register, now_s: float) -> None:
        may = self._may(self._ids.may_say, packet.topic, now_s)
        found = self._topics.register(packet.topic) if may else None
        code = 0 if found is not None else packets.CONGESTION if may else packets.INVALID_TOPIC
        if self.stage is Stage.UP:
            self._answer(packets.Regack(found or 0, packet.msg_id, code))

    def _on_subscribe(self, packet: packets.Subscribe, now_s: float) -> None:
        topic = self._topics.name_of(packet.topic)
        if packet.topic == TOGETHER:
            self._sender.together = True
            self._answer(packets.Suback(TOGETHER, packet.msg_id))
            if not self._address.is_proven:
                self._sender.probe(now_s)
        elif topic is None or not self._may(self._ids.may_hear, topic, now_s):
            self._count("air_topic", f"{self.client_id}: {packet.topic}: not one that its drone hears")
            if self.stage is Stage.UP:
                self._answer(packets.Suback(0, packet.msg_id, packets.INVALID_TOPIC))
        else:
            self._topics.hear(packet.topic)
            self._asking = packet
            self._broker.subscribe(topic, packet.live_only, packet.msg_id)

    def _may(self, rule: Callable[[int | None, str], bool], topic: str, now_s: float) -> bool:
        """Whether `rule` allows the topic; ends a client that names another drone than its own, or another client's."""
        drone = self._ids.drone_of(topic)
        is_first = self.drone is None and drone is not None
        if is_first:
            self.drone = drone
        if drone not in (None, self.drone) or (is_first and not self._claim(self, now_s)):
            self.end(now_s)
            return False
        return rule(self.drone, topic)

    # Connecting and leaving.

    def _on_will_topic(self, packet: packets.WillTopic) -> None:
        self.drone = self._ids.drone_of(packet.topic)
        if self.drone is None or not self._ids.may_say(self.drone, packet.topic):
            self._count("air_topic", f"{self.client_id}: will {packet.topic}: not one that a drone publishes")
            self._send(packets.Connack(packets.NOT_SUPPORTED))
            self.stage = Stage.GONE
            return
        self._will_topic, self.stage = packet.topic, Stage.WILL
        self._send(packets.WillMsgReq())

    def _open(self, will: Will | None) -> None:
        now_s = self._last_in_s
        is_claimed = self._claim(self, now_s)
        if not is_claimed or (will is not None and not self._takes_birth(self.drone, len(will.payload), now_s)):
            self._send(packets.Connack(packets.CONGESTION))
            self.stage = Stage.GONE
            return
        self.stage = Stage.OPENING
        self._broker.open(self.client_id, will)

    def _leave(self, now_s: float, *, with_will: bool) -> None:
        if self.is_there:
            self._broker.close(with_will=with_will)
        self.stage, self._since_s = Stage.LEFT, now_s

    def _answer(self, packet: _Answer) -> None:
        self._last_answer = packet
        self._send(packet)

    def _send(self, packet: Packet) -> None:
        """Send a packet; one beyond the limit of an unproven address is lost, as if on the way."""
        datagram = codec.encode(packet)
        if self._address.takes(len(datagram)):
            self._send_datagram(datagram)


def _is_stream(message: Message) -> bool:
    """Whether it is a piece of the stream of messages together; the client may have registered a topic as 1."""
    return message.topic_id == TOGETHER and message.id_type == PREDEFINED
