"""The log of events, in order: bounded, searchable, and exported as JSON lines."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from typing import Any

from ..core.printable import printable
from ..protocol.fields import Named
from ..protocol.names import in_fleet
from ..protocol.states import Armed, AutopilotText, FlightMode, LandedState, State
from ..station.outcomes import ControlChanged, Event, Outcome, PsmiList, QodsRanking, Reachability, StateUpdate
from .words import choice_in_plain_english, code_of, headline, in_plain_english

KEPT = 10_000
KEPT_OF_ALL = 20_000
"""Events, including those without an entry."""
_WATCHED = (Armed, FlightMode, LandedState, AutopilotText)
"""States whose changes are entered; positions and the like would drown everything else."""


class EventLog:
    """The newest `KEPT` entries; each has a number that rises by one.

    Parameters:
        kept: how many entries are kept.
    """

    def __init__(self, kept: int = KEPT) -> None:
        self._entries: deque[dict[str, Any]] = deque(maxlen=kept)
        self._all: deque[dict[str, Any] | tuple[datetime, Event]] = deque(maxlen=KEPT_OF_ALL)
        self._before: dict[tuple[str, int, int, str], object] = {}
        self.last = 0

    def on_event(self, event: Event) -> None:
        """Enter a noteworthy event; any other only appears in the export of all events."""
        if self._is_of_note(event):
            self.add(type(event).__name__, text_of(event), event)
        else:
            self._all.append((datetime.now(UTC), event))

    def add(self, kind: str, text: str, event: Event | None = None) -> None:
        """Enter an event with its fields, or an action of this page."""
        self.last += 1
        entry = {"number": self.last, **_entry(datetime.now(UTC), kind, text, event)}
        self._entries.append(entry)
        self._all.append(entry)

    def after(self, number: int, most: int) -> list[dict[str, Any]]:
        """The newest entries after a number, at most `most`, oldest first."""
        count = min(self.last - number, most, len(self._entries))
        return [self._entries[index] for index in range(-count, 0)]

    def lines(self, search: str = "", of_all: bool = False) -> Iterator[str]:
        """Every entry that contains a text, in any case, as a line of JSON; with `of_all` every event.

        Events without an entry have no number.
        """
        wanted = search.casefold()
        for kept in tuple(self._all if of_all else self._entries):  # more arrive meanwhile
            line = json.dumps(kept if isinstance(kept, dict) else _entry_of(*kept), ensure_ascii=False)
            if wanted in line.casefold():
                yield line + "\n"

    def _is_of_note(self, event: Event) -> bool:
        """Whether an event is entered: watched states and orders of rankings if changed, everything else always."""
        key: tuple[str, int, int, str]
        value: object
        if isinstance(event, StateUpdate):
            key, value = (event.fleet, event.fog, event.drone, event.state.name), event.state
            if not isinstance(value, _WATCHED):
                return False
        elif isinstance(event, QodsRanking):
            key, value = (event.fleet, event.fog, 0, "ranking"), [ranked.drone for ranked in event.ranking]
        else:
            return True
        is_new = self._before.get(key) != value or isinstance(value, AutopilotText)
        self._before[key] = value
        return is_new


def _entry_of(at: datetime, event: Event) -> dict[str, Any]:
    return _entry(at, type(event).__name__, text_of(event), event)


def _entry(at: datetime, kind: str, text: str, event: Event | None) -> dict[str, Any]:
    code = code_of(event) if isinstance(event, Outcome | PsmiList) else None
    plain = None if event is None else as_plain(event)
    return {"time": at.isoformat(timespec="milliseconds"), "kind": kind, "text": text, "code": code, "event": plain}


def text_of(event: Event) -> str:
    """An event as one line of plain English."""
    if isinstance(event, Outcome):
        return f"{headline(event)}. {in_plain_english(event)}"
    if isinstance(event, PsmiList):
        return ". ".join(choice_in_plain_english(event))
    if isinstance(event, Reachability):
        return f"drone {in_fleet(event.fleet, event.drone)}: {'reachable' if event.reachable else 'not reachable'}"
    if isinstance(event, ControlChanged):
        holder = "nobody" if event.holder is None else printable(event.holder)
        return f"drone {in_fleet(event.fleet, event.drone)}: controlled by {'this station' if event.mine else holder}"
    if isinstance(event, StateUpdate):
        return f"drone {in_fleet(event.fleet, event.drone)}: {_text_of_state(event.state)}"
    if isinstance(event, QodsRanking):
        return f"fog {in_fleet(event.fleet, event.fog)}: QoDS ranking {[ranked.drone for ranked in event.ranking]}"
    return printable(str(event).replace("\n", "; "))


def _text_of_state(state: State) -> str:
    if isinstance(state, Armed):
        return "armed" if state.armed else "disarmed"
    if isinstance(state, FlightMode):
        return f"flight mode {state.mode.label.replace('_', ' ')}"
    if isinstance(state, LandedState):
        return f"landed state {state.landed.label.replace('_', ' ')}"
    if isinstance(state, AutopilotText):
        return f"autopilot, {state.severity.label}: {printable(state.text)}"
    shown = ", ".join(f"{name} {value}" for name, value in as_plain(state).items())
    return printable(f"{state.name.replace('_', ' ')}: {shown}")


def as_plain(value: Any) -> Any:
    """A message's dataclass as JSON values: fields by their names, enumerations by theirs, bytes in hexadecimal."""
    if isinstance(value, Named):
        return value.label
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, tuple | list):
        return [as_plain(item) for item in value]
    if is_dataclass(value):
        return {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}
    return value
