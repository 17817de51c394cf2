"""Observations of a flight's folder that decide whether the attempt counts: captures, events, links and flight logs.

The run makes them once its containers have ended; for a series of an older run, its reader does. `validity` judges
them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from ..errors import ResultsError
from . import flight_logs
from .pcap import read_capture
from .results import LINKS, LINKS_COUNTERS, Attempt, read_json
from .validity import FAILED, VOID, Observed, Verdict, judge, written

_STEP_NS = 50_000_000
"""A clock that jumps by this much was set. Smaller steps come from the order in which a kernel delivers frames,
or a program lines."""

Found = TypeVar("Found")


def verdict_of(attempt: Attempt, manifest: Mapping[str, Any]) -> Verdict:
    """The verdict that the run wrote into the manifest; for a run that wrote no observations, one made now."""
    verdict = written(manifest)
    if "observed" in manifest or verdict.status == VOID:
        return verdict
    if verdict.status == FAILED:  # its run judged its flights, by the rules of its time
        return judge(Observed(verdict.reason, off_links=_shapers_word(attempt)))
    return judge(observe(attempt, manifest, None))


def observe(
    attempt: Attempt,
    manifest: Mapping[str, Any],
    failure: str | None,
    off_links: Callable[[], tuple[str, ...]] | None = None,
) -> Observed:
    """Observe a flight's folder after its containers have ended.

    `failure` is why its mission was not completed. `off_links` reads how the links differed from their plan; by default
    the shaper's own report is read.
    """
    reader = _Reader(attempt)
    off = reader.read(off_links or (lambda: _shapers_word(attempt))) or ()
    flights = reader.read(lambda: _flights(attempt, failure)) or ()
    counts = reader.read(attempt.captures)
    dropped = {count["node"]: count["dropped"] for count in counts or () if count["dropped"] != 0}
    if failure is not None:
        return Observed(failure, off_links=off, flights=flights, dropped=dropped)
    events = reader.read(attempt.events)
    logs = reader.read(attempt.autopilot_events)
    set_back = reader.read(lambda: _set_back(attempt, events or [], logs or {}))
    return Observed(
        off_links=off,
        flights=flights,
        uncaptured=uncaptured(attempt, manifest) if counts is not None else (),
        dropped=dropped,
        has_end=events is None or any(event["event"] == "mission_end" for event in events),
        silent=_silent(events or [], logs) if logs is not None else (),
        set_back=set_back,
        unreadable=tuple(reader.unreadable),
    )


def uncaptured(attempt: Attempt, manifest: Mapping[str, Any]) -> tuple[str, ...]:
    """The nodes without a capture: no file, or one that did not end properly. Raises ResultsError if the list of
    captures cannot be read."""
    captured = {
        count["node"] for count in attempt.captures() if (attempt.path / "pcap" / f"{count['node']}.pcap").exists()
    }
    return tuple(sorted({node["name"] for node in manifest["topology"]["nodes"]} - captured))


class Clock:
    """Observes whether this machine's clock is set, from now on.

    No step moves the monotonic clock, whose rate NTP changes as it does the other's, and it stands still while the
    machine is suspended.
    """

    def __init__(self) -> None:
        self._ahead_ns = _ahead_of_monotonic_ns()

    def set_s(self) -> float | None:
        """By how many seconds the clock was set forward, or (negative) back; None if it was not."""
        step_ns = _ahead_of_monotonic_ns() - self._ahead_ns
        return step_ns / 1e9 if abs(step_ns) >= _STEP_NS else None


def _ahead_of_monotonic_ns() -> int:
    """The system's time without the monotonic one, by the reading of several that was interrupted the least."""
    readings = []
    for _ in range(3):
        before_ns, now_ns = time.monotonic_ns(), time.time_ns()
        readings.append((time.monotonic_ns() - before_ns, now_ns - before_ns))
    return min(readings)[1]


class _Reader:
    """Reads files, and collects the errors of unreadable ones, with paths relative to the series."""

    def __init__(self, attempt: Attempt) -> None:
        self._series = f"{attempt.path.parent.parent}/"
        self.unreadable: dict[str, None] = {}

    def read(self, read: Callable[[], Found]) -> Found | None:
        """Return the result of `read`; None if a file that it needs cannot be read."""
        try:
            return read()
        except ResultsError as error:
            self.unreadable[str(error).replace(self._series, "")] = None
            return None


def _shapers_word(attempt: Attempt) -> tuple[str, ...]:
    """Why the shaper did not keep up; empty if it did, if nothing shaped the links, or if it left no counters.

    An older run judged its links itself when it flew.
    """
    try:
        late = read_json(attempt.path / LINKS / LINKS_COUNTERS).get("void")
    except ResultsError:
        return ()
    return (str(late),) if late else ()


def _flights(attempt: Attempt, failure: str | None) -> tuple[str, ...]:
    """What the autopilots' logs have against a flight; for a failed one only what its simulation can have caused."""
    found = flight_logs.against(attempt) if failure is None else flight_logs.simulation_reason(attempt)
    return () if found is None else (found,)


def _silent(events: Iterable[Mapping[str, Any]], logs: Mapping[str, Sequence[Mapping[str, Any]]]) -> tuple[str, ...]:
    flown = [f"uav{drone}" for event in events if event["event"] == "mission_start" for drone in event["drones"]]
    return tuple(node for node in flown if not any(event["event"] == "disarmed" for event in logs.get(node, ())))


def _set_back(
    attempt: Attempt, events: Sequence[Mapping[str, Any]], logs: Mapping[str, Sequence[Mapping[str, Any]]]
) -> tuple[str, float] | None:
    """The file with the largest step back in time between two entries, and the step in seconds; None if it is below
    `_STEP_NS`."""
    steps_ns = {
        path.name: int(-np.diff(read_capture(path).t_ns).min(initial=0))
        for path in sorted((attempt.path / "pcap").glob("*.pcap"))
    }
    for name, written_down in {
        "events.jsonl": events,
        **{f"sitl/{node}.jsonl": log for node, log in logs.items()},
    }.items():
        times = [int(event["t_ns"]) for event in written_down]
        steps_ns[name] = max((before - after for before, after in pairwise(times)), default=0)
    worst = max(steps_ns, key=lambda name: steps_ns[name])
    return (worst, steps_ns[worst] / 1e9) if steps_ns[worst] >= _STEP_NS else None
