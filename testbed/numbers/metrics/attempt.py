"""One attempt's entry in `metrics.json`: all numbers from its folder."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any

import polars as pl

from ...errors import ResultsError
from ...fly import flight_logs
from ...fly.observations import uncaptured
from ...fly.results import Attempt
from ...fly.validity import COMPLETED, Verdict
from ..attempt_entry import AttemptEntry, AttemptNumbers, FlightLogEntry, KindOfMessages, MissionNumbers, OutcomeEntry
from ..observed import observe_attempt
from ..packets import Packets, load
from . import delays, mavlink, mqttxt, readings, timeline
from .causes import losses
from .exchange import count_messages
from .message_set import measure_kinds
from .notes import machines_note, notes, others_note, unsent_note
from .shaping import Shaping, read_shaping
from .sizes import message_sizes
from .traffic import count_before, count_foreign, count_links, count_mqtt
from .ways import Ways
from .window import Window, arm_asked_ns, mission_window


def measure_attempt(attempt: Attempt, manifest: dict[str, Any], verdict: Verdict) -> AttemptEntry:
    """Measure one attempt. Raises ResultsError if a file is missing or cannot be read."""
    completed = verdict.status == COMPLETED
    if completed and (lost := uncaptured(attempt, manifest)):
        raise ResultsError(f"no capture at {', '.join(lost)}")
    events = attempt.events()
    shaping = read_shaping(attempt)
    packets = load(attempt) if arm_asked_ns(events) is not None else None
    if packets is not None and packets.unread:
        expected = f"the session keys of every connection, {packets.unread} directions cannot be read to their ends"
        raise ResultsError(f"{attempt.key_log}: expected {expected}")
    window = mission_window(attempt, events, packets)
    flights = flight_logs.compare_flights(attempt) if completed else {}
    not_flown: AttemptNumbers = {**NOT_FLOWN, "notes": list(shaping.notes)}
    entry: AttemptEntry = {
        "attempt": attempt.number,
        "repeat": attempt.repeat,
        "status": verdict.status,
        "reason": verdict.reason,
        "mission_s": round(window.seconds, 3) if window is not None and completed else None,
        **(
            not_flown
            if packets is None or window is None
            else _measured(attempt, manifest, packets, window, events, shaping)
        ),
        **readings.measure(attempt, manifest, packets, window, shaping),
        "outcomes": outcomes(events),
        "links_measured": shaping.measured,
        "flight_logs": {node: _flight_log(found) for node, found in flights.items()},
        "cpu_s": manifest.get("cpu_s", {}),
        "memory_bytes": manifest.get("memory_bytes", {}),
        "wire_loss": None,
    }
    entry["wire_loss"] = observe_attempt(entry).frames.share
    return entry


def _measured(
    attempt: Attempt,
    manifest: dict[str, Any],
    packets: Packets,
    window: Window,
    events: list[dict[str, Any]],
    shaping: Shaping,
) -> MissionNumbers:
    """The numbers from the packets in a mission's window."""
    ways = Ways(attempt.topology())
    is_mavlink = attempt.protocol == "mavlink"
    side = mavlink if is_mavlink else mqttxt
    shared = manifest["configuration"].get("chain") == "shared"
    exchange = side.measure(packets, ways, window, events)
    commands = count_messages(exchange.commands, {d: packets.until_ns[node] for d, node in ways.drones.items()})
    states = count_messages(exchange.states, exchange.states_until_ns(packets, ways))
    links = count_links(packets, window)
    by_cause = losses(packets, shaping.counters, shaping.start_ns)
    foreign = count_foreign(packets, window)
    named = pl.concat([side.name_messages(packets.messages, ways.drones), readings.name_readings(packets.messages)])
    described = mavlink.describe(packets, ways, window, shared) if is_mavlink else None
    said = notes(packets, shaping, by_cause, window, foreign)
    said += unsent_note(described["unsent"]) if described is not None else []
    said += machines_note(manifest) + others_note(manifest)
    by_autopilots = attempt.autopilot_events()
    by_one_clock = {} if manifest.get("machines") else by_autopilots
    return {
        "window": {"start_ns": window.start_ns, "seconds": round(window.seconds, 6)},
        "size_bytes": sum(link.bytes for link in links.values()),
        "packets": sum(link.packets for link in links.values()),
        "message_loss": {"commands": _share(commands), "states": _share(states)},
        "commands_sent": sum(kind["sent"] for kind in commands.values()),
        "states_sent": sum(kind["sent"] for kind in states.values()),
        "messages": {"commands": commands, "states": states},
        "losses": by_cause,
        "delay_ms": delays.by_capture_ms(exchange.commands),
        "delay_app_ms": delays.calls_ms(events, window),
        "delay_received_ms": delays.received_ms(events, by_one_clock, ways.by_fog, window),
        "receipts": delays.receipts(events, by_autopilots, ways.by_fog, window),
        "state_delay_ms": delays.states_ms(exchange.states, events, window),
        "frames_per_call": exchange.frames_per_call,
        "message_sizes": message_sizes(packets, named, window),
        "size_histogram": timeline.sizes(packets, window),
        "layers": dict(sorted(sum((link.layers for link in links.values()), Counter[str]()).items())),
        "purposes": timeline.purposes(packets, window),
        "retransmissions": timeline.retransmissions(packets, window),
        "load": timeline.load(packets, ways, window),
        "traffic": timeline.over_time(packets, window),
        "mqtt": count_mqtt(packets, window),
        "mavlink": described,
        "links": {
            name: {"packets": link.packets, "bytes": link.bytes, "lost": link.lost, "layers": dict(link.layers)}
            for name, link in sorted(links.items())
        },
        "links_events": shaping.events_since(window),
        "before_mission": count_before(packets, window),
        "foreign": foreign,
        "truncated": list(packets.truncated),
        "message_set": measure_kinds(packets, ways, window, events, exchange, is_mavlink),
        "notes": said,
    }


def _flight_log(found: flight_logs.Comparison) -> FlightLogEntry:
    return {
        "version": found.version,
        "changes": [{"event": one.event, "at_s": one.at_s, "late_ms": one.late_ms} for one in found.changes],
        "clock_ms": found.clock_ms,
        "speed": found.speed,
        "height_m": found.height_m,
        "off": found.off,
    }


def _share(kinds: dict[str, KindOfMessages]) -> float | None:
    known = sum(kind["sent"] - kind["open"] for kind in kinds.values())
    return sum(kind["lost"] for kind in kinds.values()) / known if known else None


NOT_FLOWN: AttemptNumbers = {
    "window": None, "size_bytes": 0, "packets": 0, "message_loss": {"commands": None, "states": None},
    "commands_sent": 0, "states_sent": 0, "messages": {"commands": {}, "states": {}}, "wire_loss": None,
    "losses": None, "delay_ms": {}, "delay_app_ms": {}, "delay_received_ms": {}, "state_delay_ms": {},
    "frames_per_call": {}, "message_sizes": {}, "size_histogram": {}, "layers": {}, "purposes": {},
    "retransmissions": {"packets": 0, "bytes": 0, "needless": 0, "links": {}}, "load": {}, "traffic": {},
    "mqtt": {}, "mavlink": None, "links": {}, "links_events": [],
    "before_mission": {"packets": 0, "bytes": 0, "other": 0}, "foreign": {}, "truncated": [], "message_set": None,
    "series": [], "reading_delay_ms": None, "reading_traffic": {}, "out_of_range": 0, "flight_logs": {}, "notes": [],
}  # fmt: skip
"""The numbers of an attempt whose mission never began."""


def outcomes(events: list[dict[str, Any]]) -> dict[str, list[OutcomeEntry]]:
    """Each drone's last words in order, each with its milliseconds since the call."""
    calls = {event["call"]: event["t_ns"] for event in events if event["event"] == "command"}
    found: dict[str, list[OutcomeEntry]] = defaultdict(list)
    for event in events:
        if event["event"] == "outcome" and event["final"] and event["drone"] is not None and event["call"] in calls:
            after_ms = round((event["t_ns"] - calls[event["call"]]) / 1e6, 1)
            word: OutcomeEntry = {
                "command": event["command"],
                "word": event["word"],
                "reason": event["reason"],
                "after_ms": after_ms,
            }
            found[str(event["drone"])].append(word)
    return dict(sorted(found.items()))
