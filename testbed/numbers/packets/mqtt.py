"""MQTT packets in TCP streams: segments put in the order of their sequence numbers, then read packet by packet."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import accumulate

MQTT_TYPES = (
    *("reserved", "connect", "connack", "publish", "puback", "pubrec", "pubrel", "pubcomp"),
    *("subscribe", "suback", "unsubscribe", "unsuback", "pingreq", "pingresp", "disconnect", "auth"),
)
SYN = 0x02
VERSION_5 = 5
_CONNECT, _PUBLISH = 1, 3
_TOPIC_ALIAS = 0x23
_FIXED_PROPERTIES = {0x01: 1, 0x02: 4, _TOPIC_ALIAS: 2}
"""Bytes of a PUBLISH's properties (MQTT 5.0, 3.3.2.3); the others are strings, or a variable byte integer."""
_TEXTS = {0x03: 1, 0x08: 1, 0x09: 1, 0x26: 2}


@dataclass(frozen=True)
class Segment:
    """What one frame carries of a direction of a connection; `row` names it, `left_ns` is None for a lost one."""

    row: int
    left_ns: int | None
    sequence: int
    syn: bool
    body: bytes


@dataclass(frozen=True)
class Packet:
    """An MQTT packet: the frame with its first byte, and when its last byte had left the link (None if never).

    `topic` and `payload` are those of a PUBLISH; the topic is the one that an alias stands for (MQTT 5.0, 3.3.2.3.4),
    empty where the capture does not have it. `size` is bytes of MQTT, or None for a packet that was cut off. `copies`
    counts the frames that carried its first byte.
    """

    row: int
    left_ns: int | None
    kind: str
    topic: str | None
    payload: bytes | None
    size: int | None
    copies: int


@dataclass
class Direction:
    """What one direction of the connections between two ports carried.

    For each frame with a body `payload_bytes` are the bytes of PUBLISHes' payloads in it, and `carried` is the packet
    to which its first byte belongs. `version` is what the last CONNECT asked for; it decides how both directions are to
    be read.
    """

    packets: list[Packet] = field(default_factory=list)
    payload_bytes: dict[int, int] = field(default_factory=dict)
    carried: dict[int, Packet] = field(default_factory=dict)
    version: int | None = None


def read_direction(segments: list[Segment], version: int = VERSION_5) -> Direction:
    """The MQTT packets of one direction, whose segments are in the order of time.

    `version` is the protocol level to read PUBLISHes by until a CONNECT says another. Where bytes are missing or are
    no MQTT, reading goes on at the next segment, as if a packet began there.
    """
    found = Direction()
    for segment_group in connections(segments):
        aliases: dict[int, str] = {}
        for run in _runs(segment_group):
            version = run.read(found, aliases, version)
    found.packets.sort(key=lambda packet: packet.row)
    return found


def connections(segments: list[Segment]) -> Iterator[list[Segment]]:
    """The segments of each connection: a SYN begins one."""
    group: list[Segment] = []
    for segment in segments:
        if segment.syn and group:
            yield group
            group = []
        group.append(segment)
    if group:
        yield group


@dataclass
class _Run:
    """Bytes of a connection without a gap. Places are those of the stream, counted from the connection's first byte.

    `pieces` are the segments that gave bytes, and `begins` the places from which on each did; `copies` are those that
    brought bytes again, and `copy_begins` the places of their first ones; `longest_copy` is in bytes.
    """

    origin: int
    data: bytearray = field(default_factory=bytearray)
    begins: list[int] = field(default_factory=list)
    pieces: list[Segment] = field(default_factory=list)
    copies: list[Segment] = field(default_factory=list)
    copy_begins: list[int] = field(default_factory=list)
    longest_copy: int = 0
    places: list[tuple[int, Segment]] = field(default_factory=list)

    def add(self, place: int, segment: Segment) -> None:
        """Take in the next segment, which begins at or before the end of what is there."""
        self.places.append((place, segment))
        fresh = segment.body[self.reached - place :]
        if place < self.reached:
            self.copies.append(segment)
            self.copy_begins.append(place)
            self.longest_copy = max(self.longest_copy, len(segment.body))
        if fresh:
            self.begins.append(self.reached)
            self.pieces.append(segment)
            self.data += fresh

    @property
    def reached(self) -> int:
        return self.origin + len(self.data)

    def read(self, found: Direction, aliases: dict[int, str], version: int) -> int:
        """Read all packets into `found`; returns the protocol version by which to go on."""
        payloads: list[tuple[int, int]] = []
        starts: list[int] = []
        already = len(found.packets)
        base, at = self.origin, 0
        while at < len(self.data):
            length = _remaining_length(self.data, at + 1)
            kind = self.data[at] >> 4
            if kind == 0 or (length is None and at + 5 <= len(self.data)):
                following = bisect_right(self.begins, base + at)
                at = self.begins[following] - base if following < len(self.begins) else len(self.data)
                continue
            remaining, used = length if length is not None else (0, 0)
            start, end = at + 1 + used, at + 1 + used + remaining
            starts.append(base + at)
            if length is None or end > len(self.data):
                found.packets.append(self._packet(at, None, kind, None, None))
                break
            topic, payload = None, None
            rest = bytes(self.data[start:end])
            if kind == _CONNECT:
                version = found.version = _connect_version(rest)
            elif kind == _PUBLISH:
                topic, payload_at = _publish(rest, self.data[at] >> 1 & 3, aliases, version)
                if payload_at is not None:
                    payload = rest[payload_at:]
                    payloads.append((base + start + payload_at, base + end))
            found.packets.append(self._packet(at, end, kind, topic, payload))
            at = end
        self._share(found, payloads)
        for place, segment in self.places:
            number = bisect_right(starts, place) - 1
            if number >= 0:
                found.carried[segment.row] = found.packets[already + number]
        return version

    def _packet(self, at: int, end: int | None, kind: int, topic: str | None, payload: bytes | None) -> Packet:
        base = self.origin
        first, place = bisect_right(self.begins, base + at) - 1, base + at
        copies = 1 + len(self._copies_with(place, place + 1))
        size = end - at if end is not None else None
        left_ns = self._left_ns(place, base + end) if end is not None else None
        return Packet(self.pieces[first].row, left_ns, MQTT_TYPES[kind], topic, payload, size, copies)

    def _left_ns(self, start: int, end: int) -> int | None:
        """When the first copy of each byte had left the link; None where one never did."""
        latest = 0
        for number in range(bisect_right(self.begins, start) - 1, bisect_left(self.begins, end)):
            low = max(start, self.begins[number])
            high = min(end, self.begins[number + 1] if number + 1 < len(self.begins) else end)
            carriers = [self.pieces[number], *self._copies_with(low, high)]
            times = [carrier.left_ns for carrier in carriers if carrier.left_ns is not None]
            if not times:
                return None
            latest = max(latest, min(times))
        return latest

    def _copies_with(self, start: int, end: int) -> list[Segment]:
        since = bisect_left(self.copy_begins, end - self.longest_copy)
        until = bisect_right(self.copy_begins, start)
        numbers = range(since, until)
        return [self.copies[n] for n in numbers if self.copy_begins[n] + len(self.copies[n].body) >= end]

    def _share(self, found: Direction, payloads: list[tuple[int, int]]) -> None:
        """How many bytes of each frame are payloads."""
        starts = [start for start, _ in payloads]
        before = [0, *accumulate(end - start for start, end in payloads)]

        def up_to(place: int) -> int:
            number = bisect_right(starts, place)
            if number == 0:
                return 0
            start, end = payloads[number - 1]
            return before[number - 1] + min(place, end) - start

        for place, segment in self.places:
            found.payload_bytes[segment.row] = up_to(place + len(segment.body)) - up_to(place)


def _runs(segments: list[Segment]) -> Iterator[_Run]:
    """The bytes of a connection, in the order of their sequence numbers; a new run after each gap."""
    first = segments[0].sequence + segments[0].syn
    places = [((segment.sequence + segment.syn - first + 2**31) % 2**32) - 2**31 for segment in segments]
    with_body = [(place, segment) for place, segment in zip(places, segments, strict=True) if segment.body]
    run: _Run | None = None
    for place, segment in sorted(with_body, key=lambda entry: entry[0]):
        if run is not None and place > run.reached:
            yield run
            run = None
        if run is None:
            run = _Run(place)
        run.add(place, segment)
    if run is not None:
        yield run


def _connect_version(rest: bytes) -> int:
    """The protocol level of a CONNECT (MQTT 5.0, 3.1.2.2)."""
    name_end = 2 + int.from_bytes(rest[:2], "big")
    return rest[name_end] if name_end < len(rest) else VERSION_5


def _publish(rest: bytes, qos: int, aliases: dict[int, str], version: int) -> tuple[str | None, int | None]:
    """A PUBLISH's topic, and where in `rest` its payload begins; None where it is not known."""
    if len(rest) < 2:
        return None, None
    topic_end = 2 + int.from_bytes(rest[:2], "big")
    topic = rest[2:topic_end].decode("utf-8", errors="replace")
    start = topic_end + (2 if qos else 0)
    if version < VERSION_5:
        return (topic, start) if start <= len(rest) else (None, None)
    properties = _remaining_length(rest, start)
    if properties is None or start + properties[1] + properties[0] > len(rest):
        return None, None
    begin = start + properties[1]
    payload_at = begin + properties[0]
    alias = _topic_alias(rest[begin:payload_at])
    if alias is not None:
        topic = topic or aliases.get(alias, "")
        aliases[alias] = topic
    return topic, payload_at


def _topic_alias(properties: bytes) -> int | None:
    """The topic alias among a PUBLISH's properties, None without one."""
    position = 0
    while position < len(properties):
        kind = properties[position]
        position += 1
        if kind == _TOPIC_ALIAS:
            return int.from_bytes(properties[position : position + 2], "big")
        if kind in _FIXED_PROPERTIES:
            position += _FIXED_PROPERTIES[kind]
        elif kind in _TEXTS:
            for _ in range(_TEXTS[kind]):
                position += 2 + int.from_bytes(properties[position : position + 2], "big")
        else:
            number = _remaining_length(properties, position)
            if number is None:
                return None
            position += number[1]
    return None


def _remaining_length(data: bytes | bytearray, position: int) -> tuple[int, int] | None:
    """A variable byte integer and how many bytes it took; None where it is cut off or none."""
    value = 0
    for used in range(1, 5):
        if position >= len(data):
            return None
        byte = data[position]
        value |= (byte & 0x7F) << 7 * (used - 1)
        if byte < 0x80:
            return value, used
        position += 1
    return None
