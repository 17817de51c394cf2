"""The message set as flown: when each kind was measured, its calls or values, and their outcomes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import polars as pl

from ...fly.pcap import Ints

GOOD_WORDS = frozenset({"accepted", "in_progress", "completed"})
"""First words about a call by which the autopilot took the command."""
NO_WORD = "no word about it"
NOT_IN_TIME = "did not come in time"

Event = dict[str, Any]
Span = tuple[int, int]
"""Start and end in nanoseconds, both inclusive."""


@dataclass(frozen=True)
class Call:
    """An API call: when it was made, when its first word arrived (None: never), why it failed (None: it did not)."""

    t_ns: int
    heard_ns: int | None
    failure: str | None

    @property
    def took_ms(self) -> float | None:
        """The time from the call to the word that the autopilot took it; None without such a word."""
        if self.heard_ns is None or self.failure is not None:
            return None
        return round((self.heard_ns - self.t_ns) / 1e6, 3)


@dataclass(frozen=True)
class MeasuredKind:
    """A kind of message while it was measured. `form` is command or state, `asked` the number of calls or values due.

    `received` counts the calls that the autopilot took, or the values that arrived. `spans` are the times in which
    traffic is counted: from each call to its first word, or all of a state's time.
    """

    name: str
    form: str
    asked: int
    start_ns: int
    end_ns: int
    received: int
    reasons: dict[str, int]
    spans: tuple[Span, ...]
    calls: tuple[Call, ...] = ()
    ages_ms: tuple[float, ...] = ()
    """The age of each value of a state when it reached the program, an upper bound; empty if the protocol has none."""

    @property
    def seconds(self) -> float:
        return sum(end - start for start, end in self.spans) / 1e9

    @property
    def entered(self) -> pl.Expr:
        """Whether a row of packets or messages entered its link while the kind was measured, in a span or not."""
        return pl.col("t_ns").is_between(self.start_ns, self.end_ns)

    def rows_within(self, t_ns: Ints) -> Ints:
        """The indexes of the times within the spans; `t_ns` is sorted."""
        if not self.spans:
            return np.empty(0, dtype=np.int64)
        starts, ends = np.array(self.spans, dtype=np.int64).T
        firsts, lasts = np.searchsorted(t_ns, starts, "left"), np.searchsorted(t_ns, ends, "right")
        rows = [np.arange(first, last) for first, last in zip(firsts, lasts, strict=True)]
        return np.unique(np.concatenate(rows)).astype(np.int64)


def kinds_of(events: list[Event]) -> list[MeasuredKind]:
    """The kinds in the order of the flight; empty for a mission that is not the message set."""
    return [_kind(part) for part in _parts(events)]


@dataclass
class _KindEvents:
    """The events of a kind, from its `kind` to its `kind_done`, or else to the last before the next kind."""

    begin: Event
    end_ns: int
    done: Event | None = None
    events: list[Event] = field(default_factory=list)


def _parts(events: list[Event]) -> Iterator[_KindEvents]:
    part: _KindEvents | None = None
    for event in events:
        if event["event"] == "kind":
            if part is not None:
                yield part
            part = _KindEvents(event, int(event["t_ns"]))
        elif part is not None:
            part.end_ns = int(event["t_ns"])
            if event["event"] == "kind_done":
                part.done = event
                yield part
                part = None
            else:
                part.events.append(event)
    if part is not None:
        yield part


def _kind(part: _KindEvents) -> MeasuredKind:
    return _command(part) if part.begin["form"] == "command" else _state(part)


def _command(part: _KindEvents) -> MeasuredKind:
    calls = tuple(_calls(part))
    return MeasuredKind(
        name=str(part.begin["name"]),
        form="command",
        asked=int(part.begin["count"]),
        start_ns=int(part.begin["t_ns"]),
        end_ns=part.end_ns,
        received=sum(call.failure is None for call in calls),
        reasons=dict(sorted(Counter(call.failure for call in calls if call.failure is not None).items())),
        spans=tuple((call.t_ns, call.heard_ns if call.heard_ns is not None else part.end_ns) for call in calls),
        calls=calls,
    )


def _state(part: _KindEvents) -> MeasuredKind:
    name, start_ns = str(part.begin["name"]), int(part.begin["t_ns"])
    values = [event for event in part.events if event["event"] == "value" and event["name"] == name]
    missing = int(part.done["missing"]) if part.done is not None else 0
    return MeasuredKind(
        name=name,
        form="state",
        asked=int(part.begin["count"]),
        start_ns=start_ns,
        end_ns=part.end_ns,
        received=len(values),
        reasons={NOT_IN_TIME: missing} if missing else {},
        spans=((start_ns, part.end_ns),),
        ages_ms=tuple(float(value["age_ms"]) for value in values if value.get("age_ms") is not None),
    )


def _calls(part: _KindEvents) -> Iterator[Call]:
    """The kind's calls, each with its first word."""
    words: dict[int, Event] = {}
    for event in part.events:
        if event["event"] == "outcome":
            words.setdefault(event["call"], event)
    made = [e for e in part.events if e["event"] == "command" and e["command"] == part.begin["name"]]
    for number, call in enumerate(made):
        word = words.get(call["call"])
        if word is None:  # its span ends with the mission's next step
            later = [e for e in part.events if e["t_ns"] > call["t_ns"] and e["event"] in ("reset", "command")]
            heard_ns = int(later[0]["t_ns"]) if later and number + 1 < len(made) else None
            yield Call(int(call["t_ns"]), heard_ns, NO_WORD)
            continue
        failure = None
        if word["word"] not in GOOD_WORDS:
            failure = f"{word['word']} ({word['reason']})" if word["reason"] else str(word["word"])
        yield Call(int(call["t_ns"]), int(word["t_ns"]), failure)
