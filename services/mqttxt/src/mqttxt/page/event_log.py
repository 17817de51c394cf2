"""What has happened, in order: bounded, searchable, and written as JSON lines."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from typing import Any

from ..core.printable import printable
from ..protocol.fields import Named
from ..protocol.states import Armed, AutopilotText, FlightMode, LandedState
from ..station.outcomes import ControlChanged, Event, Outcome, QodsRanking, Reachability, StateUpdate
from .words import in_plain_english

KEPT = 10_000
_WATCHED = (Armed, FlightMode, LandedState, AutopilotText)
"""States whose changes are entered; positions and the like would bury everything else."""


class EventLog:
    """The newest `KEPT` entries; each has a number that rises by one.

    Parameters:
        kept: how many.
    """

    def __init__(self, kept: int = KEPT) -> None:
        self._entries: deque[dict[str, Any]] = deque(maxlen=kept)
        self._before: dict[tuple[int, int, str], object] = {}
        self.last = 0

    def on_event(self, event: Event) -> None:
        """Enter an event; a state only where it is one of note and has changed, a ranking where its order has."""
        if isinstance(event, StateUpdate):
            if not isinstance(event.state, _WATCHED):
                return
            key = (event.fog, event.drone, event.state.name)
            if self._before.get(key) == event.state and not isinstance(event.state, AutopilotText):
                return
            self._before[key] = event.state
        if isinstance(event, QodsRanking):
            order = [ranked.drone for ranked in event.ranking]
            if self._before.get((event.fog, 0, "ranking")) == order:
                return
            self._before[event.fog, 0, "ranking"] = order
        self.add(type(event).__name__, text_of(event), as_plain(event))

    def add(self, kind: str, text: str, event: dict[str, Any] | None = None) -> None:
        """Enter an event with its fields, or something that this page did itself."""
        self.last += 1
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._entries.append({"number": self.last, "time": at, "kind": kind, "text": text, "event": event})

    def after(self, number: int, most: int) -> list[dict[str, Any]]:
        """The newest entries behind a number, at most so many, oldest first."""
        count = min(self.last - number, most, len(self._entries))
        return [self._entries[index] for index in range(-count, 0)]

    def lines(self, search: str = "") -> Iterator[str]:
        """Every entry that contains a text, whatever its case, as a line of JSON."""
        wanted = search.casefold()
        for entry in self._entries:
            line = json.dumps(entry, ensure_ascii=False)
            if wanted in line.casefold():
                yield line + "\n"


def text_of(event: Event) -> str:
    """An event as one line of plain English."""
    if isinstance(event, Outcome):
        return f"{event}. {in_plain_english(event)}"
    if isinstance(event, Reachability):
        return f"drone {event.drone}: {'reachable' if event.reachable else 'not reachable'}"
    if isinstance(event, ControlChanged):
        holder = "nobody" if event.holder is None else printable(event.holder)
        return f"drone {event.drone}: controlled by {'this station' if event.mine else holder}"
    if isinstance(event, StateUpdate):
        return f"drone {event.drone}: {_text_of_state(event.state)}"
    if isinstance(event, QodsRanking):
        return f"fog {event.fog}: QoDS ranking {[ranked.drone for ranked in event.ranking]}"
    return printable(str(event).replace("\n", "; "))


def _text_of_state(state: object) -> str:
    if isinstance(state, Armed):
        return "armed" if state.armed else "disarmed"
    if isinstance(state, FlightMode):
        return f"flight mode {state.mode.label.replace('_', ' ')}"
    if isinstance(state, LandedState):
        return f"landed state {state.landed.label.replace('_', ' ')}"
    assert isinstance(state, AutopilotText)
    return f"autopilot, {state.severity.label}: {printable(state.text)}"


def as_plain(value: Any) -> Any:
    """A message's dataclass as what JSON has: fields by their names, enumerations by theirs, bytes in hexadecimal."""
    if isinstance(value, Named):
        return value.label
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, tuple | list):
        return [as_plain(item) for item in value]
    if is_dataclass(value):
        return {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}
    return value
