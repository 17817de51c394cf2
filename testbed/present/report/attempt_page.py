"""The data of one attempt on the page: its conditions, its trouble, its files, its flights."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ...errors import ResultsError
from ...fly.results import Attempt, Series, read_json
from ...numbers.attempt_entry import AttemptEntry
from ...numbers.metrics.detail import detail_of
from ...numbers.observed import observe_attempt
from ...numbers.quantities import of_attempt
from ...numbers.written import Metrics, VoidEntry
from ...plan import wording
from . import sentences
from .figures.flights import Flights, flights, flights_of
from .figures.readings import DetailedReadings
from .gallery import DetailData
from .message_set import is_message_set


def page_of(series: Series, attempt: Attempt, metrics: Metrics, repeat: int = 0) -> dict[str, Any]:
    """The template's data for an attempt; `measured` is its entry in `metrics.json`, None for a void one.

    `repeat` is how often the number had been flown before: a void attempt is flown again under the same number.
    """
    manifest = attempt.manifest()
    side = metrics["protocols"][attempt.protocol]
    voids = [entry for entry in side["void"] if entry["attempt"] == attempt.number]
    void = voids[repeat] if repeat < len(voids) else None
    counted = (entry for entry in side["attempts"] if entry["attempt"] == attempt.number)
    measured = next(counted, None) if void is None else None
    events = _events(attempt)
    captures = manifest.get("captures", [])
    seen, own = None, None
    flies = not is_message_set(metrics)  # in the message set the drone is moved to where each call starts
    if flies and measured is not None and (window := _window(measured)) is not None:
        seen = flights_of(
            attempt.protocol, attempt.autopilot_events(), events, *window, measured["status"] == "completed"
        )
        own = flights([seen], f"flights-{attempt.protocol}-{attempt.number}")
    return {
        "number": attempt.number,
        "protocol": attempt.protocol,
        "name": wording.name_of(attempt.protocol),
        "id": f"{attempt.protocol}-{attempt.number}"
        + (f"-void-{repeat + 1}" if void is not None and measured is None else ""),
        "label": f"{attempt.number}{f', repeat {repeat}' if repeat else ''}",
        "manifest": manifest,
        "measured": measured,
        "row": of_attempt(observe_attempt(measured)) if measured is not None else {},
        "trouble": _trouble(measured, void, events),
        "folder": attempt.path.relative_to(series.path).as_posix(),
        "files": [path.relative_to(series.path).as_posix() for path in _files(attempt)],
        "attempt": attempt,
        "late_ms": _object(attempt.path / "links" / "counters.json").get("late_ms"),
        "flights": seen,
        "own_flights": own,
        "events": events,
        "commands": list(dict.fromkeys(event["command"] for event in events if event["event"] == "command")),
        "dropped": sum(capture.get("dropped") or 0 for capture in captures),
        "captured": sum(capture.get("captured") or 0 for capture in captures),
    }


def _events(attempt: Attempt) -> list[dict[str, Any]]:
    """The mission's events; none where they cannot be read, for which the attempt is void or has no numbers."""
    try:
        return attempt.events()
    except ResultsError:
        return []


def seen_of(page: dict[str, Any]) -> DetailData:
    """The data for figures of the attempt that is shown in detail."""
    attempt: Attempt = page["attempt"]
    window = _window(page["measured"])
    flown: Flights | None = page["flights"]
    if window is None:
        return DetailData(flown, None)
    detail = detail_of(attempt, *window)
    measured = DetailedReadings(detail.measured, window[0]) if detail.measured is not None else None
    return DetailData(flown, detail.per_link, measured)


def with_losses(attempt: Attempt, measured: AttemptEntry) -> AttemptEntry:
    """Add each link's random loss to the entry's measured links: as planned, and as the shaper counted it among the
    frames that could be lost at random. Unchanged if the shaper left no counts.
    """
    plan, counters = (_object(attempt.path / "links" / name) for name in ("plan.json", "counters.json"))
    planned = plan.get("plan", {}).get("links", {})
    links = {name: dict(figures) for name, figures in measured["links_measured"].items()}
    for name, counted in counters.get("links", {}).items():
        frames = counted.get("random", 0) + counted.get("left", 0)
        share = counted.get("random", 0) / frames if frames else None
        if name in links and name in planned and "loss" not in links[name]:
            links[name]["loss"] = {"configured": planned[name].get("loss"), "measured": share}
    return {**measured, "links_measured": links}


def _object(path: Path) -> dict[str, Any]:
    """A file's JSON object; empty without the file, and for a damaged one, which `metrics.json` names."""
    try:
        return read_json(path)
    except ResultsError:
        return {}


def flown_at(attempts: list[dict[str, Any]]) -> str:
    """When the first mission began, as '21 November 2026, 16:32 UTC'; empty if none did."""
    begun = [e["t_ns"] for one in attempts for e in one["events"] if e["event"] == "mission_start"]
    if not begun:
        return ""
    at = datetime.fromtimestamp(min(begun) // 1_000_000_000, UTC)
    return f"{at.day} {_MONTHS[at.month - 1]} {at:%Y, %H:%M} UTC"


_MONTHS = (
    *("January", "February", "March", "April", "May", "June"),
    *("July", "August", "September", "October", "November", "December"),
)
"""In English always, unlike those of strftime, which depend on the machine's locale."""


def _window(measured: AttemptEntry) -> tuple[int, float] | None:
    """When the mission began, and how many seconds were counted; None if it never began."""
    told = measured["window"]
    return (told["start_ns"], told["seconds"]) if told is not None else None


def _trouble(
    measured: AttemptEntry | None, void: VoidEntry | None, events: list[dict[str, Any]]
) -> dict[str, Any] | None:
    """Why an attempt failed or is void, its last step, its last words, and captures that were cut off; None if all is
    well."""
    truncated = measured["truncated"] if measured is not None else []
    status = "void" if measured is None else measured["status"]
    if status == "completed" and not truncated:
        return None
    reason = measured["reason"] if measured is not None else void["reason"] if void is not None else None
    first, _, rest = (reason or "").strip().partition("\n")
    begun = [event["name"] for event in events if event["event"] in ("step", "kind")]
    done = [event["name"] for event in events if event["event"] == "kind_done"]
    done += [event["name"] for event in events if event["event"] == "step_done" and event["ok"]]
    return {
        "status": status,
        "reason": first or "no reason given",
        "more": rest,
        "done": done,
        "step": next((name for name in begun if name not in done), None),
        "begun": any(event["event"] == "mission_start" for event in events),
        "words": sentences.not_completed(measured["outcomes"], reason or "") if measured is not None else [],
        "truncated": truncated,
    }


def _files(attempt: Attempt) -> list[Path]:
    patterns = (
        *("manifest.json", "events.jsonl", "pcap/*.pcap", "pcap/captures.json"),
        *("packets.parquet", "messages.parquet", "links/*", "sitl/*.jsonl", "sensors/*.jsonl"),
        *("series.json", "logs/*.log"),
    )
    return [path for pattern in patterns for path in sorted(attempt.path.glob(pattern))]
