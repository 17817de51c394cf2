"""Metrics: what an attempt's captures and events say, in numbers; and `metrics.json` of a series."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jsonschema

from mqttxt.errors import PayloadError
from mqttxt.messages import CommandMessage
from mqttxt.wire.codec import decode
from mqttxt.wire.states import decode_state

from .capture import CaptureNotes, Frame, Publish, read_frames
from .errors import ResultsError
from .results import METRICS, Attempt, Series, write_json
from .topology import Topology
from .validity import common_revision, unsound_reason

METRICS_VERSION = 1
SCHEMA = Path(__file__).parent / "schemas" / "metrics.schema.json"
Key = tuple[Any, ...]


@dataclass
class LinkCount:
    """What entered a directed link in the window: frames, bytes by layer, and frames that did not leave it."""

    packets: int = 0
    bytes: int = 0
    lost: int = 0
    layers: Counter[str] = field(default_factory=Counter)


@dataclass
class Traffic:
    """Everything that was counted from the captures of one attempt."""

    links: dict[str, LinkCount] = field(default_factory=lambda: defaultdict(LinkCount))
    before: LinkCount = field(default_factory=LinkCount)
    foreign: Counter[str] = field(default_factory=Counter)
    mqtt: Counter[str] = field(default_factory=Counter)
    commands_sent: dict[Key, int] = field(default_factory=dict)
    commands_received: dict[Key, dict[int, int]] = field(default_factory=lambda: defaultdict(dict))
    states_sent: set[Key] = field(default_factory=set)
    states_received: set[Key] = field(default_factory=set)
    truncated: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Window:
    """From the first arm command leaving the ground station to the last drone's disarming; nanoseconds."""

    start_ns: int
    end_ns: int

    @property
    def seconds(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9

    def has(self, t_ns: int) -> bool:
        return self.start_ns <= t_ns <= self.end_ns


def measure_series(series: Series) -> dict[str, Any]:
    """Metrics of every attempt; written to `metrics.json`. Raises ResultsError for a series that mixes conditions."""
    attempts = series.attempts()
    manifests = [attempt.manifest() for attempt in attempts]
    first = manifests[0]
    for attempt, manifest in zip(attempts, manifests, strict=True):
        for name in ("experiment", "arm", "profile", "shaper"):
            if manifest[name] != first[name]:
                raise ResultsError(f"{attempt.path}: {name} is {manifest[name]}, in the first attempt {first[name]}")
    document: dict[str, Any] = {
        "version": METRICS_VERSION,
        **{name: first[name] for name in ("experiment", "arm", "profile")},
        "revision": common_revision(manifests),
        "shaper": first["shaper"],
        "protocols": {},
        "ratios": {},
    }
    for attempt, manifest in zip(attempts, manifests, strict=True):
        side = document["protocols"].setdefault(attempt.protocol, {"attempts": [], "void": []})
        measured = measure_attempt(attempt, manifest)
        if measured["status"] == "void":
            side["void"].append({"attempt": attempt.number, "reason": measured["reason"]})
        else:
            side["attempts"].append(measured)
    try:
        jsonschema.validate(document, json.loads(SCHEMA.read_text(encoding="utf-8")))
    except jsonschema.ValidationError as error:
        raise ResultsError(
            f"{series.path}: its metrics break their schema: {error.json_path}: {error.message}"
        ) from error
    write_json(series.path / METRICS, document)
    return document


def measure_attempt(attempt: Attempt, manifest: dict[str, Any]) -> dict[str, Any]:
    """One attempt's entry in `metrics.json`."""
    events = attempt.events()
    status, reason = manifest["status"], manifest["reason"]
    unsound = unsound_reason(attempt, manifest, events) if status == "completed" else None
    if unsound is not None:
        status, reason = "void", unsound
    window = mission_window(attempt, events)
    traffic = count_traffic(attempt, window) if window is not None else Traffic()
    links = {name: traffic.links[name] for name in sorted(traffic.links)}
    entered = sum(link.packets for link in links.values())
    lost = sum(link.lost for link in links.values())
    return {
        "attempt": attempt.number,
        "status": status,
        "reason": reason,
        "mission_s": round(window.seconds, 3) if window is not None and status == "completed" else None,
        "size_bytes": sum(link.bytes for link in links.values()),
        "packets": entered,
        "message_loss": {
            "commands": lost_share(traffic.commands_sent, traffic.commands_received),
            "states": lost_share(traffic.states_sent, traffic.states_received),
        },
        "commands_sent": len(traffic.commands_sent),
        "states_sent": len(traffic.states_sent),
        "wire_loss": lost / entered if entered else None,
        "delay_ms": command_delays_ms(traffic),
        "outcomes": outcomes(events),
        "layers": dict(sorted(sum((link.layers for link in links.values()), Counter[str]()).items())),
        "mqtt": dict(sorted(traffic.mqtt.items())),
        "links": {
            name: {"packets": link.packets, "bytes": link.bytes, "lost": link.lost, "layers": dict(link.layers)}
            for name, link in links.items()
        },
        "before_mission": {"packets": traffic.before.packets, "bytes": traffic.before.bytes},
        "foreign": dict(sorted(traffic.foreign.items())),
        "truncated": traffic.truncated,
    }


def mission_window(attempt: Attempt, events: list[dict[str, Any]]) -> Window | None:
    """None when the mission never began. A failed mission's window ends when it gave up."""
    asked = next((e["t_ns"] for e in events if e["event"] == "command" and e["command"] == "arm"), None)
    if asked is None:
        return None
    start_ns = _first_arm_frame_ns(attempt, asked)
    disarmed = [
        event["t_ns"]
        for log in attempt.autopilot_events().values()
        for event in log
        if event["event"] == "disarmed" and event["t_ns"] > start_ns
    ]
    ended = [event for event in events if event["event"] == "mission_end"]
    if ended and ended[-1]["status"] == "completed" and disarmed:
        return Window(start_ns, max(disarmed))
    last_ns = max([ended[-1]["t_ns"]] if ended else [event["t_ns"] for event in events])
    return Window(start_ns, max(last_ns, start_ns))


def _first_arm_frame_ns(attempt: Attempt, asked_ns: int) -> int:
    """When the first command left the ground station after it was asked for, by its own capture."""
    topology = attempt.topology()
    path = attempt.path / "pcap" / "gs.pcap"
    if path.exists():
        for frame in read_frames(path):
            from_gs = frame.source is not None and topology.name_of(frame.source) == "gs"
            if frame.t_ns >= asked_ns and from_gs and any(_is_command(p) for p in frame.publishes):
                return frame.t_ns
    return asked_ns


def count_traffic(attempt: Attempt, window: Window) -> Traffic:
    """Count every capture: a frame is sent where its sender's capture has it, and has left its link where the
    receiver's has it too."""
    topology = attempt.topology()
    traffic = Traffic()
    left: dict[str, Counter[bytes]] = defaultdict(Counter)
    entered: list[tuple[str, bytes]] = []
    for path in sorted((attempt.path / "pcap").glob("*.pcap")):
        notes = CaptureNotes()
        for frame in read_frames(path, notes):
            names = _names(topology, frame)
            link = topology.link_of(*names) if names is not None else None
            if names is None or link is None:
                if window.has(frame.t_ns):
                    traffic.foreign[frame.protocol] += 1
                continue
            source, destination = names
            if path.stem == destination:
                left[link][frame.key] += 1
                _note_arrival(traffic, frame, destination)
            elif path.stem == source:
                _note_departure(traffic, frame, link, source, window, entered)
        if notes.truncated:
            traffic.truncated.append(path.name)
    for link, key in entered:
        if left[link][key] > 0:
            left[link][key] -= 1
        else:
            traffic.links[link].lost += 1
    return traffic


def _note_departure(
    traffic: Traffic, frame: Frame, link: str, source: str, window: Window, entered: list[tuple[str, bytes]]
) -> None:
    if not window.has(frame.t_ns):
        if frame.t_ns < window.start_ns:
            traffic.before.packets += 1
            traffic.before.bytes += frame.size
        return
    count = traffic.links[link]
    count.packets += 1
    count.bytes += frame.size
    count.layers.update(frame.layers)
    traffic.mqtt.update(frame.mqtt)
    entered.append((link, frame.key))
    for publish in frame.publishes:
        if source == "gs" and _is_command(publish):
            key = _command_key(publish)
            if key is not None:
                traffic.commands_sent.setdefault(key, frame.t_ns)
        elif source.startswith("uav"):
            state = _state_key(publish, relayed=False)
            if state is not None:
                traffic.states_sent.add(state)


def _note_arrival(traffic: Traffic, frame: Frame, destination: str) -> None:
    for publish in frame.publishes:
        if destination.startswith("uav") and _is_command(publish):
            key = _command_key(publish)
            if key is not None:
                drone = int(destination.removeprefix("uav"))
                traffic.commands_received[key].setdefault(drone, frame.t_ns)
        elif destination == "gs":
            state = _state_key(publish, relayed=True)
            if state is not None:
                traffic.states_received.add(state)


def _names(topology: Topology, frame: Frame) -> tuple[str, str] | None:
    if frame.source is None or frame.destination is None:
        return None
    source, destination = topology.name_of(frame.source), topology.name_of(frame.destination)
    return (source, destination) if source is not None and destination is not None else None


def _is_command(publish: Publish) -> bool:
    return publish.topic.rsplit("/", 1)[-1] == "commands"


def _command_key(publish: Publish) -> Key | None:
    """(GS session, seq) and the command's name: what names a command from end to end."""
    try:
        message = decode(CommandMessage, publish.payload)
    except PayloadError:
        return None
    return (message.gs_session, message.seq, message.command.name)


def _state_key(publish: Publish, relayed: bool) -> Key | None:
    """(drone, state, origin stamp): what names a state from end to end."""
    levels = publish.topic.split("/")
    if len(levels) < 3 or levels[-2] != "state":
        return None
    try:
        return (levels[-3], levels[-1], decode_state(levels[-1], publish.payload, relayed).stamp)
    except PayloadError:
        return None


def lost_share(sent: Collection[Key], received: Collection[Key]) -> float | None:
    """Which part of what was sent in the window never arrived; what arrived besides does not count."""
    return sum(key not in received for key in sent) / len(sent) if sent else None


def command_delays_ms(traffic: Traffic) -> dict[str, list[float]]:
    """One way, by capture: a command's first frame leaving gs to its first copy reaching each drone."""
    found: dict[str, list[float]] = defaultdict(list)
    for key, sent_ns in traffic.commands_sent.items():
        for _, received_ns in sorted(traffic.commands_received.get(key, {}).items()):
            found[str(key[2])].append(round((received_ns - sent_ns) / 1e6, 3))
    return dict(found)


def outcomes(events: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Each drone's last words in their order, with the milliseconds from the call to each."""
    calls = {event["call"]: event["t_ns"] for event in events if event["event"] == "command"}
    found: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for event in events:
        if event["event"] == "outcome" and event["final"] and event["drone"] is not None:
            after_ms = round((event["t_ns"] - calls[event["call"]]) / 1e6, 1)
            entry = {name: event[name] for name in ("command", "word", "reason")}
            found[str(event["drone"])].append({**entry, "after_ms": after_ms})
    return dict(sorted(found.items()))
