"""MQTT packets in TCP streams, also inside TLS if the session's keys are known."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import accumulate

from .streams import Plain, Run, Segment, connections, runs
from .tls import Clear, Secrets, client_random

MQTT_TYPES = (
    *("reserved", "connect", "connack", "publish", "puback", "pubrec", "pubrel", "pubcomp"),
    *("subscribe", "suback", "unsubscribe", "unsuback", "pingreq", "pingresp", "disconnect", "auth"),
)
VERSION_5 = 5
_CONNECT, _PUBLISH = 1, 3
_TOPIC_ALIAS = 0x23
_FIXED_PROPERTIES = {0x01: 1, 0x02: 4, _TOPIC_ALIAS: 2}
"""Sizes of a PUBLISH's properties in bytes (MQTT 5.0, 3.3.2.3); others are strings or a variable byte integer."""
_TEXTS = {0x03: 1, 0x08: 1, 0x09: 1, 0x26: 2}


@dataclass(frozen=True)
class Packet:
    """An MQTT packet: the row of the frame with its first byte, and when all up to its last byte had left the link.

    `left_ns` is None if a byte of it never left. `topic` and `payload` are those of a PUBLISH. An alias (MQTT 5.0,
    3.3.2.3.4) is replaced by its topic, which is empty if the capture does not have it. `size` is bytes of MQTT, None
    for a packet that was cut off. `copies` counts the frames that carried its first byte.
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
    """The content of one direction of the connections between two ports.

    By row of each frame with a body: `payload_bytes` are its bytes of PUBLISHes' payloads, `tls_bytes` those of TLS
    itself, and `carried` is the packet of its first byte. `repeated` has the datagrams that bring a message again,
    and whether an earlier one had left the link. `version` is the protocol level of the last CONNECT, by which both
    directions are read. `is_unread`: some TLS records cannot be decrypted.
    """

    packets: list[Packet] = field(default_factory=list)
    payload_bytes: dict[int, int] = field(default_factory=dict)
    tls_bytes: dict[int, int] = field(default_factory=dict)
    carried: dict[int, Packet] = field(default_factory=dict)
    repeated: dict[int, bool] = field(default_factory=dict)
    version: int | None = None
    is_unread: bool = False


def read_direction(segments: list[Segment], version: int = VERSION_5) -> Direction:
    """Read the MQTT packets of one direction, whose segments are sorted by time.

    `version` is the protocol level by which PUBLISHes are read until a CONNECT has another. After missing bytes, or
    bytes that are no MQTT, reading goes on at the next segment, as if a packet began there.
    """
    found = Direction()
    for segment_group in connections(segments):
        aliases: dict[int, str] = {}
        for run in runs(segment_group):
            version = _read(run, Plain(run), found, aliases, version)
    found.packets.sort(key=lambda packet: packet.row)
    return found


def read_tls_direction(segments: list[Segment], sessions: Iterable[Secrets], version: int = VERSION_5) -> Direction:
    """As `read_direction`, for a direction in TLS 1.3; `sessions` are the secrets that may open it.

    Records after a gap cannot be decrypted, because their sequence numbers are unknown.
    """
    known = list(sessions)
    found = Direction()
    for segment_group in connections(segments):
        aliases: dict[int, str] = {}
        for number, run in enumerate(runs(segment_group)):
            clear = Clear.of(run, known) if number == 0 else Clear(is_unread=True)
            found.is_unread = found.is_unread or clear.is_unread
            for place, segment in run.places:
                inside = clear.before(place + len(segment.body)) - clear.before(place)
                found.tls_bytes[segment.row] = len(segment.body) - inside
            version = _read(run, clear, found, aliases, version)
    found.packets.sort(key=lambda packet: packet.row)
    return found


def randoms_of(segments: list[Segment]) -> list[bytes]:
    """The client randoms of the connections in a direction towards a broker, which identify their sessions."""
    firsts = [next(runs(group), None) for group in connections(segments)]
    found = [client_random(bytes(run.data)) for run in firsts if run is not None]
    return [random for random in found if random is not None]


def _read(run: Run, content: Plain | Clear, found: Direction, aliases: dict[int, str], version: int) -> int:
    """Read all packets into `found`; returns the protocol level for the packets that follow."""
    data = content.data
    payloads: list[tuple[int, int]] = []
    starts: list[int] = []
    already = len(found.packets)
    at = 0
    while at < len(data):
        length = _remaining_length(data, at + 1)
        kind = data[at] >> 4
        if kind == 0 or (length is None and at + 5 <= len(data)):
            at = content.resume(at)
            continue
        remaining, used = length if length is not None else (0, 0)
        start, end = at + 1 + used, at + 1 + used + remaining
        starts.append(at)
        if length is None or end > len(data):
            found.packets.append(_packet(run, content, at, None, kind, None, None))
            break
        topic, payload = None, None
        rest = bytes(data[start:end])
        if kind == _CONNECT:
            version = found.version = _connect_version(rest)
        elif kind == _PUBLISH:
            topic, payload_at = _publish(rest, data[at] >> 1 & 3, aliases, version)
            if payload_at is not None:
                payload = rest[payload_at:]
                payloads.append((start + payload_at, end))
        found.packets.append(_packet(run, content, at, end, kind, topic, payload))
        at = end
    _share(run, content, found, payloads)
    for place, segment in run.places:
        served = content.serves(place)
        number = bisect_right(starts, served) - 1 if served is not None else -1
        if number >= 0:
            found.carried[segment.row] = found.packets[already + number]
    return version


def _packet(
    run: Run, content: Plain | Clear, at: int, end: int | None, kind: int, topic: str | None, payload: bytes | None
) -> Packet:
    place = content.place(at)
    size = end - at if end is not None else None
    left_ns = run.left_ns(*content.needs(at, end)) if end is not None else None
    return Packet(run.row_of(place), left_ns, MQTT_TYPES[kind], topic, payload, size, run.copies_of(place))


def _share(run: Run, content: Plain | Clear, found: Direction, payloads: list[tuple[int, int]]) -> None:
    """Count each frame's bytes of payloads."""
    starts = [start for start, _ in payloads]
    before = [0, *accumulate(end - start for start, end in payloads)]

    def up_to(offset: int) -> int:
        number = bisect_right(starts, offset)
        if number == 0:
            return 0
        start, end = payloads[number - 1]
        return before[number - 1] + min(offset, end) - start

    for place, segment in run.places:
        ends = content.before(place), content.before(place + len(segment.body))
        found.payload_bytes[segment.row] = up_to(ends[1]) - up_to(ends[0])


def _connect_version(rest: bytes) -> int:
    """The protocol level of a CONNECT (MQTT 5.0, 3.1.2.2)."""
    name_end = 2 + int.from_bytes(rest[:2], "big")
    return rest[name_end] if name_end < len(rest) else VERSION_5


def _publish(rest: bytes, qos: int, aliases: dict[int, str], version: int) -> tuple[str | None, int | None]:
    """A PUBLISH's topic, and the position of its payload in `rest`; None where unknown."""
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
    """The topic alias among a PUBLISH's properties; None without one."""
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
    """A variable byte integer and its length in bytes; None if it is cut off or invalid."""
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
