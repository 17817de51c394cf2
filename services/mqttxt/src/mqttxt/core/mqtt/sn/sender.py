"""Reliable delivery over datagrams: one packet in flight at a time, repeated until it is answered (MQTT-SN 1.2, 6.13).

Each end has a `Sender` for its own packets and a `Receiver` that recognises repetitions of the other end's.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf

from ..round_trip import RoundTrip
from .codec import size_of_publish
from .packets import Message, Packet, Puback, Suback, Subscribe, Unsuback, Unsubscribe
from .together import AirMessage, pack
from .topic_ids import TOGETHER, TopicIds

LARGEST_DATAGRAM = 1200
"""Bytes of a datagram without IP and UDP headers: no link cuts it (RFC 8085, section 3.2; IPv6's minimum is 1,280)."""
FIRST_S, LEAST_S, LONGEST_S = 0.5, 0.1, 2.0
"""Time before a packet is repeated: without a measured round trip, at least, and at most."""
GIVE_UP_S = 15.0
"""A connection is lost after this long without an answer."""
MOST_WAITING = 1000
"""How many messages wait at most, as Mosquitto keeps for a client; further ones are dropped."""
MOST_WAITING_BYTES = 1 << 19
"""How many bytes their payloads have at most."""
MOST_IDS = 65_535
"""Message ids: 1 to this."""

Answer = Puback | Suback | Unsuback
Asked = Subscribe | Unsubscribe
Done = Callable[[int], None]


@dataclass
class _Tell:
    told: AirMessage
    done: Done | None
    key: str | None = None


@dataclass
class _Ask:
    packet: Asked
    done: Done


@dataclass
class _UnderWay:
    packet: Message | Asked
    done: list[Done]
    first_s: float
    sent_s: float
    times: int = 1


@dataclass
class _Stream:
    """Messages that are sent together: their bytes, and the offset at which each message ends."""

    left: bytes = b""
    ends: deque[tuple[int, Done | None]] = field(default_factory=deque)


def repeat_after_s(round_trip: RoundTrip, times: int) -> float:
    """How long to wait for an answer to a packet that was sent `times` times (R20.5)."""
    first_s = round_trip.usual_s(0.0) if round_trip.is_known else FIRST_S
    return min(LONGEST_S, float(max(LEAST_S, first_s) * 2 ** (times - 1)))


class Sender:
    """Sends messages that must arrive, in order. `together`: the other side accepts messages together and in pieces.

    `id_of` returns the topic id, and its type, that the other side has for a topic. Message ids begin after `last_id`.
    """

    def __init__(
        self,
        send: Callable[[Packet], None],
        ids: TopicIds,
        round_trip: RoundTrip,
        id_of: Callable[[str], tuple[int, int] | None],
        together: bool,
        last_id: int = 0,
    ) -> None:
        self.together = together
        self._send = send
        self._ids = ids
        self._id_of = id_of
        self._round_trip = round_trip
        self._waiting: deque[_Tell | _Ask] = deque()
        self._waiting_bytes = 0
        self._keyed: dict[str, _Tell] = {}
        self._stream = _Stream()
        self._under_way: _UnderWay | None = None
        self._msg_id = last_id

    @property
    def is_idle(self) -> bool:
        """Whether every packet is answered and none waits."""
        return self._under_way is None and not self._waiting and not self._stream.left

    def tell(self, told: AirMessage, now_s: float, done: Done | None = None, key: str | None = None) -> bool:
        """Send a message after those that wait; `done` gets the return code. `key` is for `forget`.

        Returns False if too much waits, or if the other side cannot take a message of this length or topic.
        """
        waiting_bytes = self._waiting_bytes + len(told.payload)
        if len(self._waiting) >= MOST_WAITING or waiting_bytes > MOST_WAITING_BYTES:
            return False
        if not (self.together or self._fits_alone(told)):
            return False
        item = _Tell(told, done, key)
        if key is not None:
            self._keyed[key] = item
        self._waiting.append(item)
        self._waiting_bytes = waiting_bytes
        self._go_on(now_s)
        return True

    def forget(self, key: str) -> None:
        """Drop the waiting message with this key, if any."""
        item = self._keyed.pop(key, None)
        if item is not None:
            self._waiting.remove(item)
            self._waiting_bytes -= len(item.told.payload)

    def ask(self, packet: Asked, now_s: float, done: Done) -> None:
        """Send a SUBSCRIBE or UNSUBSCRIBE after those that wait; its message id is set here. `done` as in `tell`."""
        self._waiting.append(_Ask(packet, done))
        self._go_on(now_s)

    def probe(self, now_s: float) -> None:
        """Make the other side answer: if no packet is in flight, send an empty piece of the stream."""
        if self._under_way is None:
            self._start(Message(TOGETHER, b"", qos=1, msg_id=self._next_id()), [], now_s)

    def on_answer(self, answer: Answer, now_s: float) -> bool:
        """An acknowledgement arrived; returns whether it is for the packet in flight. Any other changes nothing."""
        current = self._under_way
        kind = {Puback: Message, Suback: Subscribe, Unsuback: Unsubscribe}.get(type(answer))
        if current is None or not isinstance(current.packet, kind or ()) or current.packet.msg_id != answer.msg_id:
            return False
        if current.times == 1:  # the answer to a repeated packet may be for any of its copies (Karn)
            self._round_trip.took(now_s - current.sent_s)
        self._under_way = None
        code = answer.code if not isinstance(answer, Unsuback) else 0
        for done in current.done:
            done(code)
        self._go_on(now_s)
        return True

    def tick(self, now_s: float) -> None:
        """Repeat the packet in flight if it is due."""
        current = self._under_way
        if current is not None and now_s >= self._due_s(current):
            current.times += 1
            current.sent_s = now_s
            again = current.packet
            self._send(again if isinstance(again, Unsubscribe) else replace(again, dup=True))

    def due_s(self) -> float:
        """When to call `tick` next; infinite without a packet in flight."""
        return self._due_s(self._under_way) if self._under_way is not None else inf

    def is_lost(self, now_s: float) -> bool:
        """Whether the other side has not answered for too long."""
        return self._under_way is not None and now_s - self._under_way.first_s >= GIVE_UP_S

    def _due_s(self, current: _UnderWay) -> float:
        return current.sent_s + repeat_after_s(self._round_trip, current.times)

    def _go_on(self, now_s: float) -> None:
        if self._under_way is not None or self.is_idle:
            return
        head = self._waiting[0] if self._waiting else None
        if not self._stream.left and isinstance(head, _Ask):
            self._waiting.popleft()
            self._start(replace(head.packet, msg_id=self._next_id()), [head.done], now_s)
        elif not self._stream.left and isinstance(head, _Tell) and self._is_single(head.told):
            self._take()
            topic_id, id_type = self._id_of(head.told.topic) or (0, 0)
            message = Message(topic_id, head.told.payload, id_type, 1, self._next_id(), head.told.retain)
            self._start(message, [head.done] if head.done is not None else [], now_s)
        else:
            self._start(*self._piece(), now_s)

    def _is_single(self, told: AirMessage) -> bool:
        """Whether to send a message as a PUBLISH of its own."""
        if not self.together:
            return True
        others_wait = len(self._waiting) > 1 and isinstance(self._waiting[1], _Tell)
        return not others_wait and self._fits_alone(told)

    def _fits_alone(self, told: AirMessage) -> bool:
        return size_of_publish(told.payload) <= LARGEST_DATAGRAM and self._id_of(told.topic) is not None

    def _piece(self) -> tuple[Message, list[Done]]:
        """The next piece of the stream, as a datagram, and the callbacks of the messages that end in it."""
        most = LARGEST_DATAGRAM - size_of_publish(b"")
        stream = self._stream
        while len(stream.left) < most and self._waiting and isinstance(self._waiting[0], _Tell):
            item = self._take()
            stream.left += pack(item.told, self._ids)
            stream.ends.append((len(stream.left), item.done))
        piece, stream.left = stream.left[:most], stream.left[most:]
        done: list[Done] = []
        while stream.ends and stream.ends[0][0] <= len(piece):
            _, each = stream.ends.popleft()
            if each is not None:
                done.append(each)
        stream.ends = deque((end - len(piece), each) for end, each in stream.ends)
        return Message(TOGETHER, piece, qos=1, msg_id=self._next_id()), done

    def _take(self) -> _Tell:
        item = self._waiting.popleft()
        assert isinstance(item, _Tell)
        self._waiting_bytes -= len(item.told.payload)
        if item.key is not None:
            del self._keyed[item.key]
        return item

    def _start(self, packet: Message | Asked, done: list[Done], now_s: float) -> None:
        self._under_way = _UnderWay(packet, done, now_s, now_s)
        self._send(packet)

    def _next_id(self) -> int:
        self._msg_id = self._msg_id % MOST_IDS + 1
        return self._msg_id


class Receiver:
    """Recognises repetitions: the other side's message ids rise, and one that does not is a repetition."""

    def __init__(self) -> None:
        self._last: int | None = None

    def is_new(self, msg_id: int) -> bool:
        """Whether a message id is new; if so, notes it."""
        if self._last is not None and not 0 < (msg_id - self._last) % MOST_IDS < MOST_IDS // 2:
            return False
        self._last = msg_id
        return True

    def is_last(self, msg_id: int) -> bool:
        """Whether it is the id of the newest message."""
        return msg_id == self._last
