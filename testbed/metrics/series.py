"""Metrics of a series: every attempt's numbers, written to `metrics.json`."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from pathlib import Path
from statistics import median
from typing import Any

import jsonschema

from ..errors import ResultsError
from ..packets import Packets, load
from ..results import METRICS, Attempt, Series, write_json
from ..validity import common_revision, unsound_reason
from . import mavlink, mqttxt
from .traffic import count_before, count_foreign, count_links, count_mqtt
from .ways import Ways
from .window import Window, arm_asked_ns, mission_window

METRICS_VERSION = 1
"""Rises when a field goes or its meaning changes; fields that are added leave it as it is."""
SCHEMA = Path(__file__).parents[1] / "schemas" / "metrics.schema.json"
_RATIOS = {"packets": "packets", "size": "size_bytes", "mission": "mission_s"}


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
    document["ratios"] = ratios(document["protocols"])
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
    packets = load(attempt) if arm_asked_ns(events) is not None else None
    window = mission_window(attempt, events, packets)
    return {
        "attempt": attempt.number,
        "status": status,
        "reason": reason,
        "mission_s": round(window.seconds, 3) if window is not None and status == "completed" else None,
        **(_NOT_FLOWN if packets is None or window is None else _measured(attempt, manifest, packets, window, events)),
        "outcomes": outcomes(events),
        "cpu_s": manifest.get("cpu_s", {}),
    }


def _measured(
    attempt: Attempt, manifest: dict[str, Any], packets: Packets, window: Window, events: list[dict[str, Any]]
) -> dict[str, Any]:
    """What the packets of a mission's window say."""
    ways = Ways(attempt.topology())
    is_mavlink = attempt.protocol == "mavlink"
    shared = manifest["configuration"].get("chain") == "shared"
    exchange = (mavlink if is_mavlink else mqttxt).measure(packets, ways, window, events)
    links = count_links(packets, window)
    entered = sum(link.packets for link in links.values())
    lost = sum(link.lost for link in links.values())
    return {
        "size_bytes": sum(link.bytes for link in links.values()),
        "packets": entered,
        "message_loss": {"commands": exchange.commands_lost, "states": exchange.states_lost},
        "commands_sent": exchange.commands_sent,
        "states_sent": exchange.states_sent,
        "wire_loss": lost / entered if entered else None,
        "delay_ms": exchange.delay_ms,
        "frames_per_call": exchange.frames_per_call,
        "layers": dict(sorted(sum((link.layers for link in links.values()), Counter[str]()).items())),
        "mqtt": count_mqtt(packets, window),
        "mavlink": mavlink.describe(packets, ways, window, shared) if is_mavlink else None,
        "links": {
            name: {"packets": link.packets, "bytes": link.bytes, "lost": link.lost, "layers": dict(link.layers)}
            for name, link in sorted(links.items())
        },
        "before_mission": count_before(packets, window),
        "foreign": count_foreign(packets, window),
        "truncated": list(packets.truncated),
    }


_NOT_FLOWN: dict[str, Any] = {
    **{"size_bytes": 0, "packets": 0, "message_loss": {"commands": None, "states": None}},
    **{"commands_sent": 0, "states_sent": 0, "wire_loss": None, "delay_ms": {}, "frames_per_call": {}},
    **{"layers": {}, "mqtt": {}, "mavlink": None, "links": {}},
    **{"before_mission": {"packets": 0, "bytes": 0}, "foreign": {}, "truncated": []},
}
"""What there is to say of an attempt whose mission never began."""


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


def ratios(protocols: dict[str, Any]) -> dict[str, float]:
    """MAVLink's medians over MQTT-XT's, of completed attempts; empty where one side has none."""
    completed = {
        name: [
            attempt for attempt in protocols.get(name, {"attempts": []})["attempts"] if attempt["status"] == "completed"
        ]
        for name in ("mavlink", "mqttxt")
    }
    if not all(completed.values()):
        return {}
    found = {}
    for ratio, field in _RATIOS.items():
        above, below = (median(attempt[field] for attempt in completed[name]) for name in ("mavlink", "mqttxt"))
        if below:
            found[ratio] = round(above / below, 4)
    return found
