"""Recordings: facts of named cases in JSON, numbers and times only."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..errors import SitlError
from ..personalities import PERSONALITIES

Event = tuple[float, str, str]
"""Seconds since the case began, what changed (armed, mode, landed_state, current, reached), and to which value."""


@dataclass
class Case:
    """The facts of one case; times in seconds, rates in Hz, sizes in bytes."""

    acks: list[tuple[str, str | None]] = field(default_factory=list)
    """Each command and its MAV_RESULT in order; null without an answer."""
    events: list[Event] = field(default_factory=list)
    durations_s: dict[str, float] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    streams: dict[str, tuple[float, float]] = field(default_factory=dict)
    """For each kind of message: its rate in Hz, and its mean size in bytes."""
    track: list[tuple[float, ...]] = field(default_factory=list)
    """Once per second: time, and metres north, east and up of the place where the case began."""


@dataclass
class Recording:
    """The cases of one autopilot, each with all of its flights, for no two flights are alike."""

    autopilot: str
    cases: dict[str, list[Case]] = field(default_factory=dict)
    like: str = "px4"
    """Its family: the personality that is compared with it."""

    def add(self, other: Recording) -> None:
        """Add the flights of another recording."""
        for name, flights in other.cases.items():
            self.cases.setdefault(name, []).extend(flights)

    def text(self) -> str:
        """JSON with one fact of a flight per line."""
        cases = []
        for name, flights in sorted(self.cases.items()):
            texts = []
            for case in flights:
                facts = [f"   {json.dumps(key)}: {json.dumps(value)}" for key, value in asdict(case).items() if value]
                texts.append("  {\n" + ",\n".join(facts) + "\n  }")
            cases.append(f" {json.dumps(name)}: [\n" + ",\n".join(texts) + "\n ]")
        return (
            f'{{"autopilot": {json.dumps(self.autopilot)}, "like": {json.dumps(self.like)}, "cases": {{\n'
            + ",\n".join(cases)
            + "\n}}\n"
        )

    def save(self, path: Path) -> None:
        """Replace the file atomically. Raises SitlError."""
        part = path.with_name(f".{path.name}.part")
        try:
            part.write_text(self.text(), encoding="utf-8")
            os.replace(part, path)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise SitlError(f"{path}: {error.strerror}") from error


def load(path: Path) -> Recording:
    """Read a recording. Raises SitlError naming the file and its defect."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        cases = {name: [_case(facts) for facts in flights] for name, flights in document["cases"].items()}
        recording = Recording(document["autopilot"], cases, document["like"])
    except OSError as error:
        raise SitlError(f"{path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SitlError(f"{path}: not a recording: {error!r}") from error
    if recording.like not in PERSONALITIES:
        raise SitlError(f"{path}: like {recording.like!r}: expected one of {', '.join(PERSONALITIES)}")
    return recording


def _case(facts: dict[str, Any]) -> Case:
    tuples = {name: [tuple(one) for one in facts.get(name, ())] for name in ("acks", "events", "track")}
    streams = {kind: tuple(found) for kind, found in facts.get("streams", {}).items()}
    return Case(**tuples, durations_s=facts.get("durations_s", {}), numbers=facts.get("numbers", {}), streams=streams)
