"""The mission of each drone on one time axis: its height, and each command from the call to its last word."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ....numbers import words
from ....plan import wording
from .axes import Scale, bottom, clock
from .draw import TEXT, Drawing, width_of
from .figure import Figure

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class FlownCommand:
    """A command to one drone; seconds since the mission began. `end_s` is None without a last word."""

    command: str
    start_s: float
    end_s: float | None
    word: str

    @property
    def ok(self) -> bool:
        return self.word == "completed"


@dataclass(frozen=True)
class MissionStep:
    """A step of the mission by the ground station's events; seconds since the mission began."""

    name: str
    start_s: float
    end_s: float
    ok: bool


@dataclass(frozen=True)
class Flights:
    """One attempt's flights: by drone its heights (seconds, metres) and its commands; the mission's steps."""

    protocol: str
    end_s: float
    heights: dict[str, tuple[tuple[float, float], ...]]
    calls: dict[str, tuple[FlownCommand, ...]]
    steps: tuple[MissionStep, ...]
    completed: bool


def flights_of(
    protocol: str,
    sitl: dict[str, list[dict[str, Any]]],
    events: list[dict[str, Any]],
    start_ns: int,
    end_s: float,
    completed: bool,
) -> Flights:
    """Collect an attempt's flights from the events of autopilots (`sitl`) and ground station (`events`)."""
    heights = {}
    for node, log in sitl.items():
        seen = [(_since(e["t_ns"], start_ns), float(e["altitude_m"])) for e in log if e["event"] == "position"]
        heights[node.removeprefix("uav")] = tuple(point for point in seen if -2 <= point[0] <= end_s)
    drones = sorted(heights, key=lambda drone: (len(drone), drone))
    return Flights(
        protocol,
        end_s,
        {drone: heights[drone] for drone in drones},
        {drone: _calls_of(drone, events, start_ns) for drone in drones},
        _steps_of(events, start_ns, end_s),
        completed,
    )


def _calls_of(drone: str, events: list[dict[str, Any]], start_ns: int) -> tuple[FlownCommand, ...]:
    """The calls to the drone, and those to its whole fog that it answered."""
    last = {e["call"]: e for e in events if e["event"] == "outcome" and e["final"] and str(e["drone"]) == drone}
    found = []
    for event in events:
        if event["event"] != "command" or not (str(event["drone"]) == drone or event["call"] in last):
            continue
        ended = last.get(event["call"])
        end_s = _since(ended["t_ns"], start_ns) if ended else None
        word = ended["word"] if ended else "no last word"
        found.append(FlownCommand(event["command"], _since(event["t_ns"], start_ns), end_s, word))
    return tuple(found)


def _steps_of(events: list[dict[str, Any]], start_ns: int, end_s: float) -> tuple[MissionStep, ...]:
    """The mission's steps; one that never ended lasts until the mission's end."""
    done = {event["name"]: event for event in events if event["event"] == "step_done"}
    found = []
    for event in events:
        if event["event"] == "step" and (begun := _since(event["t_ns"], start_ns)) <= end_s:
            ended = done.get(event["name"])
            until = min(_since(ended["t_ns"], start_ns), end_s) if ended else end_s
            found.append(MissionStep(event["name"], max(begun, 0.0), max(until, 0.0), bool(ended and ended["ok"])))
    return tuple(found)


def flights(sides: list[Flights], name: str = "flights") -> Figure | None:
    """The figure of flights; None if nothing flew."""
    drones = list(dict.fromkeys(drone for side in sides for drone in side.heights))
    if not drones:
        return None
    took = wording.listed([f"{words.seconds(side.end_s)} over {wording.name_of(side.protocol)}" for side in sides])
    return Figure(
        name=name,
        title="Flights",
        shows=f"Height and commands of {wording.plural(len(drones), 'drone')} over time: {took}.",
        note=(
            "A line is a drone's height by its own autopilot. Below it a bar for each side: every command from its "
            "call to its last word, with a stroke where it was called; red where the last word was not “completed”. "
            "On top the mission's steps, as the ground station took them."
        ),
        draw=lambda width: _draw(sides, drones, width),
        header=("protocol", "drone", "what", "start_s", "end_s", "altitude_m", "word"),
        rows=tuple(row for side in sides for row in _rows(side)),
        sources=("events.jsonl", "sitl"),
    )


def _rows(side: Flights) -> list[tuple[str | float | None, ...]]:
    rows: list[tuple[str | float | None, ...]] = []
    for step in side.steps:
        word = "done" if step.ok else "not done"
        rows.append(
            (side.protocol, None, f"step {step.name}", round(step.start_s, 3), round(step.end_s, 3), None, word)
        )
    for drone, calls in side.calls.items():
        for call in calls:
            end_s = None if call.end_s is None else round(call.end_s, 3)
            rows.append((side.protocol, drone, call.command, round(call.start_s, 3), end_s, None, call.word))
    for drone, heights in side.heights.items():
        rows += [(side.protocol, drone, "height", round(t, 3), None, round(m, 2), None) for t, m in heights]
    return rows


def _draw(sides: list[Flights], drones: list[str], width: float) -> Drawing:
    narrow = width < 600
    left, right = (64.0 if narrow else 78.0), width - 14.0
    strip, lift = 6.0, 30.0 if narrow else 36.0
    lane = lift + 12 + len(sides) * (strip + 3)
    top = 10.0 + 24 * len(sides)
    drawing = Drawing(width, top + lane * len(drones) + 30)
    longest = max([side.end_s for side in sides] + [1.0])
    time = Scale(0, longest, left, right)
    tallest = max([m for side in sides for heights in side.heights.values() for _, m in heights] + [1.0])
    bottom(drawing, time, clock(longest, 4 if narrow else 8), top + lane * len(drones), top - 4)
    for number, side in enumerate(sides):
        _draw_steps(drawing, side, time, 2 + 24 * number)
    for number, drone in enumerate(drones):
        base = top + lane * number + lift + 8
        drawing.line((left, base), (right, base), "edge")
        drawing.text(0, base, f"drone {drone}")
        height = Scale(0, tallest, base, base - lift)
        if number == 0:
            drawing.text(left - 5, base - lift + 6, f"{tallest:.0f} m", "faint", "end", TEXT - 1.5)
        for order, side in enumerate(sides):
            heights = [(time(t), height(m)) for t, m in side.heights.get(drone, ())]
            drawing.path(heights, side.protocol, 3.6 if order == 0 and len(sides) > 1 else 1.4)
            y = base + 4 + order * (strip + 3)
            for call in side.calls.get(drone, ()):
                _draw_call(drawing, side, call, time, y, strip)
    return drawing


def _draw_call(drawing: Drawing, side: Flights, call: FlownCommand, time: Scale, y: float, strip: float) -> None:
    start, end = time(call.start_s), time(side.end_s if call.end_s is None else call.end_s)
    after = "" if call.end_s is None else f" after {call.end_s - call.start_s:.2f} s"
    tip = f"{wording.name_of(side.protocol)}: {call.command} at {call.start_s:.2f} s, {call.word}{after}"
    role, opacity = (side.protocol, 0.55) if call.ok else ("bad", 0.9)
    drawing.rect(start, y, max(end - start, 1.5), strip, role, opacity, tip)
    drawing.line((start, y - 1), (start, y + strip + 1), "ink", 1.3)


def _draw_steps(drawing: Drawing, side: Flights, time: Scale, y: float) -> None:
    drawing.text(0, y + 13, wording.name_of(side.protocol), side.protocol, size=TEXT - 0.5)
    for step in side.steps:
        start, end = time(step.start_s), time(step.end_s)
        if end - start < 1:
            continue
        tip = f"{step.name}: {words.seconds(step.end_s - step.start_s)}{'' if step.ok else ', not done'}"
        drawing.rect(start, y, max(end - start - 1.5, 1), 18, "wash" if step.ok else "bad", tip=tip)
        if width_of(step.name) + 8 < end - start:
            drawing.text(start + 5, y + 13, step.name, "soft" if step.ok else "paper", size=TEXT - 0.5)
    end = time(side.end_s)
    said = f"{'completed' if side.completed else 'gave up'} after {words.seconds(side.end_s)}"
    drawing.path([(end, y - 2), (end, y + 20)], side.protocol, 2, tip=said)


def _since(t_ns: int, start_ns: int) -> float:
    return (t_ns - start_ns) / SECOND_NS
