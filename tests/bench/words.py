"""The cost of commands and words on each link of a series: `python -m tests.bench.words results/scenario-1/latest`.

A frame's headers are divided among its messages by their bytes. An acknowledgement belongs to what it acknowledges: a
PUBACK to the messages of its packet id, several in a datagram of MQTT-SN; a bare acknowledgement of TCP to the frames
that had arrived and were not acknowledged yet. In TLS, messages cannot be told apart by their frames; such a series is
refused.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any

from mqttxt.core.mqtt.sn import codec, packets
from mqttxt.errors import PayloadError
from mqttxt.protocol.codec import decode
from mqttxt.protocol.messages import FogResultMessage, ResultMessage
from testbed.errors import ResultsError, TestbedError
from testbed.fly.pcap import read_capture
from testbed.fly.results import Attempt, open_series
from testbed.numbers.metrics import mission_window
from testbed.numbers.packets import load

STAGES = ("air", "backhaul", "wan")
_PUBLISH, _PUBACK = 3, 4
_AFTER_NS = 2_000_000_000
"""How long after the last disarming, where the mission ends, its last words may be under way."""


@dataclass
class Cost:
    """Bytes of messages: `headers` of Ethernet, IP and TCP or UDP, `framing` of MQTT with its topic, and the rest."""

    messages: float = 0
    headers: float = 0
    framing: float = 0
    payload: float = 0
    pubacks: float = 0
    tcp_acks: float = 0

    @property
    def size(self) -> float:
        return self.headers + self.framing + self.payload + self.pubacks + self.tcp_acks

    def __iadd__(self, other: Cost) -> Cost:
        self.__dict__.update(zip(self.__dict__, map(sum, zip(astuple(self), astuple(other), strict=True)), strict=True))
        return self

    def __str__(self) -> str:
        named = [f"{name} {value:,.0f}" for name, value in list(self.__dict__.items())[1:] if value]
        return f"{self.messages:.0f} messages, {self.size:,.0f} B ({', '.join(named)})"


@dataclass
class Message:
    """A message: its number, stage and kind, bytes of it and of its payload; an MQTT packet's kind and packet id.

    `is_own`: it is a command or a word.
    """

    number: int
    what: tuple[str, str]
    size: int
    payload: int
    packet: int = 0
    mid: int = 0
    is_own: bool = False
    cost: Cost = field(default_factory=Cost)


@dataclass
class Frame:
    """A frame on a link, when it entered and left it (None: never), with the messages that share its headers."""

    flow: str
    entered_ns: int
    left_ns: int | None
    size: int
    headers: int
    messages: list[Message]
    is_copy: bool = False


def share_headers(frames: Iterable[Frame]) -> None:
    """Give each message its own bytes and its part of its frame's headers, or of a whole frame that is a copy."""
    for frame in frames:
        total = sum(message.size for message in frame.messages)
        for message in frame.messages:
            message.cost.headers += (frame.size if frame.is_copy else frame.headers) * message.size / total
            if not frame.is_copy:
                message.cost += Cost(1, 0, message.size - message.payload, message.payload)


def share_acknowledgements(frames: Iterable[Frame]) -> None:
    """Give TCP's bare acknowledgements to the messages that they acknowledge, then PUBACKs to their PUBLISHes.

    `frames` are in the order in which they entered their links.
    """
    whole = list(frames)
    waiting: dict[str, list[Frame]] = defaultdict(list)
    published: dict[tuple[str, int], list[Message]] = {}
    acknowledged: list[tuple[list[Message], Message]] = []
    for frame in whole:
        back = ">".join(reversed(frame.flow.split(">")))
        came = [f for f in waiting[back] if f.left_ns is not None and f.left_ns <= frame.entered_ns]
        waiting[back] = [f for f in waiting[back] if f not in came]
        if frame.messages:
            waiting[frame.flow].append(frame)
        total = sum(message.size for f in came for message in f.messages)
        for message in (message for f in came for message in f.messages if not frame.messages):
            message.cost.tcp_acks += frame.size * message.size / total
        sure = [message for message in frame.messages if message.packet == _PUBLISH and message.mid]
        published |= {(frame.flow, mid): [m for m in sure if m.mid == mid] for mid in {m.mid for m in sure}}
        for message in frame.messages:
            if message.packet == _PUBACK and (back, message.mid) in published:
                acknowledged.append((published.pop((back, message.mid)), message))
    for publishes, puback in acknowledged:
        for publish in publishes:
            publish.cost.pubacks += puback.cost.size / len(publishes)


def _what(purpose: str, topic: str | None, body: bytes | None) -> str:
    """A message's purpose; of a word, which one it is, alone or with others."""
    if purpose != "result" or topic is None or body is None:
        return purpose
    try:
        if "drone" in topic:
            return decode(ResultMessage, body).word.label
        result = decode(FogResultMessage, body)
    except PayloadError:  # signed
        return "word"
    return "+".join(name for name in ("roster", "denied", "words") if getattr(result, name) is not None)


def _frames(attempt: Attempt) -> Iterator[Frame]:
    """The frames of the mission, with their messages. Raises ResultsError."""
    seen = load(attempt)
    window = mission_window(attempt, attempt.events(), seen)
    if window is None:
        raise ResultsError(f"{attempt.path}: no mission")
    window = replace(window, end_ns=window.end_ns + _AFTER_NS)
    if int(seen.frames["tls"].sum()):
        raise ResultsError(f"{attempt.path}: flown in TLS; expected SECURITY=none")
    data = {path.stem: read_capture(path).data for path in (attempt.path / "pcap").glob("*.pcap")}
    messages: dict[int, list[dict[str, Any]]] = defaultdict(list)
    for number, row in enumerate(seen.messages.filter(window.entered).iter_rows(named=True)):
        messages[row["frame"]].append({**row, "number": number})
    found: dict[int, list[Message]] = {}
    kept = seen.frames.with_row_index("row").filter(window.entered)
    for row in kept.iter_rows(named=True):
        stage, headers = row["link"].split(":")[0], row["ethernet"] + row["ip"] + row["transport"]
        own = []
        at = row["offset"] + headers if row["begins"] in (None, row["row"]) else None
        for told in messages[row["row"]]:
            payload = len(told["body"] or b"") if told["protocol"] == "mqtt" else told["bytes"]
            what = (stage, _what(told["purpose"], told["topic"], told["body"]))
            packet, mid = (0, 0)
            if row["protocol"] == "mqttsn" and at is not None:
                packet, mid = _datagram(data[row["node"]][at : row["offset"] + row["size"]])
            elif told["protocol"] == "mqtt" and at is not None:
                packet, mid = _packet(data[row["node"]], at)
                at += told["bytes"]
            is_own = told["purpose"] in ("command", "result")
            own.append(Message(told["number"], what, told["bytes"], payload, packet, mid, is_own))
        found[row["row"]] = own
        is_copy = not own and row["begins"] is not None
        carried = found.get(row["begins"], []) if is_copy else own
        yield Frame(row["flow"], row["t_ns"], row["left_ns"], row["size"], headers, carried, is_copy)


def _packet(data: Any, at: int) -> tuple[int, int]:
    """An MQTT packet's kind and packet id, 0 without one."""
    kind, qos, at = int(data[at]) >> 4, int(data[at]) >> 1 & 3, at + 1
    while data[at] & 0x80:
        at += 1
    at += 1
    if kind == _PUBLISH:
        at += 2 + (int(data[at]) << 8 | int(data[at + 1]))
    return kind, int(data[at]) << 8 | int(data[at + 1]) if qos or kind == _PUBACK else 0


def _datagram(data: Any) -> tuple[int, int]:
    """The same for a datagram of MQTT-SN."""
    packet = codec.decode(bytes(data))
    kinds = {packets.Message: _PUBLISH, packets.Puback: _PUBACK}
    return (kinds[type(packet)], packet.msg_id) if isinstance(packet, packets.Message | packets.Puback) else (0, 0)


def costs(attempt: Attempt) -> dict[tuple[str, str], Cost]:
    """The cost of commands and of each kind of word on each stage. Raises ResultsError."""
    frames = list(_frames(attempt))
    share_headers(frames)
    share_acknowledgements(frames)
    found: dict[tuple[str, str], Cost] = defaultdict(Cost)
    once = {message.number: message for frame in frames for message in frame.messages}
    for message in once.values():
        if message.is_own:
            found[message.what] += message.cost
    return found


def measure(path: Path) -> list[str]:
    """Lines for each completed attempt, and the ratio of bytes if both protocols were flown. Raises ResultsError."""
    out: list[str] = []
    sums: dict[str, list[float]] = defaultdict(list)
    for attempt in open_series(path).attempts():
        if attempt.manifest()["status"] != "completed":
            continue
        who, found = f"attempt {attempt.number}, {attempt.protocol}", costs(attempt)
        for stage in STAGES:
            of_stage = sorted((name, cost) for (where, name), cost in found.items() if where == stage)
            out += [f"{who}, {stage}, {name}: {cost}" for name, cost in of_stage]
            out.append(f"{who}, {stage}: {sum(cost.size for _, cost in of_stage):,.0f} B")
        sums[attempt.protocol].append(sum(cost.size for cost in found.values()))
        out.append(f"{who}: {sums[attempt.protocol][-1]:,.0f} B")
    if len(sums) == 2:
        mean = {protocol: sum(of) / len(of) for protocol, of in sums.items()}
        out.append(f"{mean['mqttxt'] / mean['mavlink']:.2f} times MAVLink's bytes")
    return out


if __name__ == "__main__":
    try:
        for said in sys.argv[1:]:
            print(said, *measure(Path(said)), sep="\n  ")
    except TestbedError as error:
        sys.exit(f"words: {error}")
