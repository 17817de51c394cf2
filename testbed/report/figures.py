"""The flights as a figure: where each drone was, on a time axis that all panels share.

Everything is given in percent of the axis, so that the page draws it at any width with text of one size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Flight:
    """One drone's flight; times in seconds since the mission began."""

    drone: str
    altitude: tuple[tuple[float, float], ...]
    marks: tuple[tuple[float, str, bool], ...]
    """When a command had its last word, what it was, and whether the command was completed."""


@dataclass(frozen=True)
class Step:
    """A step of the mission, by the ground station; seconds since the mission began."""

    name: str
    start_s: float
    end_s: float
    ok: bool


@dataclass(frozen=True)
class Panel:
    """One attempt's flights and steps."""

    protocol: str
    end_s: float
    flights: tuple[Flight, ...]
    steps: tuple[Step, ...]
    completed: bool


def flights_of(
    sitl: dict[str, list[dict[str, Any]]], events: list[dict[str, Any]], start_ns: int
) -> tuple[Flight, ...]:
    """Each drone's heights by its autopilot, and the last words that the ground station heard."""
    found = []
    for node, log in sorted(sitl.items()):
        drone = node.removeprefix("uav")
        heights = [
            ((event["t_ns"] - start_ns) / SECOND_NS, float(event["altitude_m"]))
            for event in log
            if event["event"] == "position"
        ]
        said = [
            (
                (event["t_ns"] - start_ns) / SECOND_NS,
                f"{event['command']} {event['word']}",
                event["word"] == "completed",
            )
            for event in events
            if event["event"] == "outcome" and event["final"] and str(event["drone"]) == drone
        ]
        found.append(Flight(drone, tuple(point for point in heights if point[0] >= -2), tuple(said)))
    return tuple(found)


def steps_of(events: list[dict[str, Any]], start_ns: int, end_s: float) -> tuple[Step, ...]:
    """The mission's steps; one that never ended lasts until the end."""
    done = {event["name"]: event for event in events if event["event"] == "step_done"}
    found = []
    for event in events:
        if event["event"] != "step":
            continue
        ended = done.get(event["name"])
        until = (ended["t_ns"] - start_ns) / SECOND_NS if ended is not None else end_s
        found.append(Step(event["name"], (event["t_ns"] - start_ns) / SECOND_NS, until, bool(ended and ended["ok"])))
    return tuple(found)


def timeline(panels: list[Panel]) -> dict[str, Any] | None:
    """What the page draws: ticks of the shared axis, and for each panel its rows; None when there is no flight."""
    drawn = [panel for panel in panels if panel.flights]
    if not drawn:
        return None
    longest_s = max([panel.end_s for panel in drawn] + [1.0])
    heights = [m for panel in drawn for flight in panel.flights for t, m in flight.altitude if t <= panel.end_s]
    most_m = max([*heights, 1.0])
    return {
        "most_m": most_m,
        "ticks": [(t, _at(t, longest_s)) for t in _ticks(longest_s)],
        "panels": [_panel(panel, longest_s, most_m) for panel in drawn],
    }


def _panel(panel: Panel, longest_s: float, most_m: float) -> dict[str, Any]:
    rows = []
    for flight in panel.flights:
        points = [
            f"{10 * _at(t, longest_s):.1f},{100 - 86 * max(m, 0.0) / most_m:.1f}"
            for t, m in flight.altitude
            if t <= panel.end_s
        ]
        marks = [{"at": _at(t, longest_s), "what": f"{what} after {t:.2f} s", "ok": ok} for t, what, ok in flight.marks]
        rows.append({"drone": flight.drone, "points": " ".join(points), "marks": marks})
    steps = [
        {
            "name": step.name,
            "left": _at(step.start_s, longest_s),
            "width": _at(min(step.end_s, panel.end_s), longest_s) - _at(step.start_s, longest_s),
            "seconds": max(step.end_s - max(step.start_s, 0.0), 0.0),
            "ok": step.ok,
        }
        for step in panel.steps
        if step.start_s <= panel.end_s
    ]
    return {
        "protocol": panel.protocol,
        "end_s": panel.end_s,
        "end": _at(panel.end_s, longest_s),
        "completed": panel.completed,
        "rows": rows,
        "steps": steps,
    }


def _at(t_s: float, longest_s: float) -> float:
    return 100 * min(max(0.0, t_s), longest_s) / longest_s


def _ticks(longest_s: float) -> list[int]:
    step = next((step for step in (1, 2, 5, 10, 20, 30, 60, 120, 300) if longest_s / step <= 8), 600)
    return list(range(0, int(longest_s) + 1, step))
