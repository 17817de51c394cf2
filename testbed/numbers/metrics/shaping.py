"""The records of an attempt's links: their calibration, their changes, and the shaper's counters."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import ResultsError
from ...fly.results import (
    LINKS,
    LINKS_CALIBRATION,
    LINKS_COUNTERS,
    LINKS_EVENTS,
    LINKS_PLAN,
    Attempt,
    read_json,
    read_json_lines,
)
from ..attempt_entry import LinkEvent
from .window import Window


@dataclass(frozen=True)
class Shaping:
    """The files of `<attempt>/links/`; missing ones are None or empty. `notes` has a line per unreadable file.

    `conditions` is the part of the plan that is the same for every attempt: without its seed and what is drawn from it.
    """

    counters: dict[str, Any] | None = None
    measured: dict[str, Any] = field(default_factory=dict)
    events: tuple[dict[str, Any], ...] = ()
    conditions: str | None = None
    notes: tuple[str, ...] = ()

    @property
    def is_shaped(self) -> bool:
        """Whether a shaper counted what the links lost."""
        return self.counters is not None and self.counters.get("shaper") != "none"

    @property
    def start_ns(self) -> int | None:
        """When the links' clock began; None if it did not, or if the shaper took no counts then."""
        if not (self.counters or {}).get("at_start"):
            return None
        return next((int(event["t_ns"]) for event in self.events if event.get("event") == "start"), None)

    def events_since(self, window: Window) -> list[LinkEvent]:
        """The changes of links, with `t_s`, seconds since the window's start, in place of the clock's time."""
        return [
            {
                "t_s": round((event["t_ns"] - window.start_ns) / 1e9, 3),
                "link": event["link"],
                "change": event.get("change"),
                "cause": event.get("cause"),
            }
            for event in self.events
            if "link" in event
        ]


def read_shaping(attempt: Attempt) -> Shaping:
    """Read the records of an attempt's links. Never raises: a damaged file is left out and named in `notes`."""
    folder = attempt.path / LINKS
    notes: list[str] = []
    counters = _links_of(folder / LINKS_COUNTERS, notes)
    calibration = _links_of(folder / LINKS_CALIBRATION, notes)
    plan = _object(folder / LINKS_PLAN, notes)
    try:
        events = read_json_lines(folder / LINKS_EVENTS, needed=frozenset({"t_ns"}))
    except ResultsError as error:
        events = []
        notes.append(str(error))
    return Shaping(
        counters,
        calibration["links"] if calibration is not None else {},
        tuple(events),
        _conditions(plan),
        tuple(note.replace(f"{attempt.path}/", "") for note in notes),
    )


def _object(path: Path, notes: list[str]) -> dict[str, Any] | None:
    if not path.exists():
        return None
    try:
        return read_json(path)
    except ResultsError as error:
        notes.append(str(error))
        return None


def _links_of(path: Path, notes: list[str]) -> dict[str, Any] | None:
    found = _object(path, notes)
    if found is None:
        return None
    links = found.get("links")
    if not isinstance(links, dict) or not all(isinstance(link, dict) for link in links.values()):
        notes.append(f"{path}: links: expected an object for each link")
        return None
    return found


def _conditions(plan: Mapping[str, Any] | None) -> str | None:
    """The links of a plan as text, by which attempts are compared."""
    inner = plan.get("plan", plan) if plan is not None else None
    links = inner.get("links") if isinstance(inner, dict) else None
    return json.dumps(links, sort_keys=True) if isinstance(links, dict) else None
