"""Figures as inline SVG; their colours are the page's CSS variables, so that they follow light and dark."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import escape

WIDTH = 860
LAYERS = ("payload", "mqtt", "tcp", "udp", "ip", "ethernet")
_LEFT, _RIGHT = 64, 16


@dataclass(frozen=True)
class Flight:
    """One drone's flight for the timeline; times in seconds since the mission began."""

    drone: str
    altitude: tuple[tuple[float, float], ...]
    marks: tuple[tuple[float, str], ...]


def flights_of(sitl: dict[str, list[dict[str, Any]]], events: list[dict[str, Any]], start_ns: int) -> list[Flight]:
    """Each drone's heights by its autopilot, and the last words that the ground station heard."""
    found = []
    for node, log in sorted(sitl.items()):
        drone = node.removeprefix("uav")
        heights = [
            ((event["t_ns"] - start_ns) / 1e9, float(event["altitude_m"]))
            for event in log
            if event["event"] == "position"
        ]
        words = [
            ((event["t_ns"] - start_ns) / 1e9, f"{event['command']} {event['word']}")
            for event in events
            if event["event"] == "outcome" and event["final"] and str(event["drone"]) == drone
        ]
        found.append(Flight(drone, tuple(point for point in heights if point[0] >= -2), tuple(words)))
    return found


def timeline(flights: list[Flight], end_s: float) -> str:
    """A row for each drone: its height, and a tick where a command had its last word."""
    row, top = 54, 26
    height = top + row * len(flights) + 30
    most_m = max([alt for flight in flights for _, alt in flight.altitude] or [1.0]) or 1.0
    parts = []
    for index, flight in enumerate(flights):
        base = top + row * (index + 1) - 8
        points = " ".join(
            f"{_x(t, end_s):.1f},{base - alt / most_m * (row - 18):.1f}" for t, alt in flight.altitude if t <= end_s
        )
        parts.append(
            f'<text class="label" x="{_LEFT - 10}" y="{base - 4}" text-anchor="end">drone {flight.drone}</text>'
        )
        parts.append(f'<line class="grid" x1="{_LEFT}" y1="{base}" x2="{WIDTH - _RIGHT}" y2="{base}"/>')
        parts.append(f'<polyline class="line" points="{points}"/>')
        for at_s, what in flight.marks:
            x = _x(at_s, end_s)
            parts.append(
                f'<g class="mark"><line x1="{x:.1f}" y1="{base - row + 16}" x2="{x:.1f}" y2="{base + 4}"/>'
                f"<title>{escape(what)} after {at_s:.2f} s</title></g>"
            )
    if flights:
        parts += _first_row_labels(flights[0], end_s, most_m, top, row)
    parts.append(_time_axis(end_s, top + row * len(flights)))
    label = f"Height of each drone over time, up to {most_m:.1f} m; ticks are last words of commands"
    return _svg(height, label, parts)


def _first_row_labels(flight: Flight, end_s: float, most_m: float, top: float, row: float) -> list[str]:
    """What all rows share, said once: the height of the scale, and which command each tick belongs to."""
    scale = f'<text class="tick" x="{_LEFT - 10}" y="{top + 14}" text-anchor="end">{most_m:.0f} m</text>'
    labels = [scale]
    free_from = 0.0
    for at_s, what in flight.marks:
        command = what.split(" ")[0]
        x, half = _x(at_s, end_s), 4.0 * len(command)
        x = min(max(x, half, free_from + half), WIDTH - half)
        free_from = x + half
        labels.append(f'<text class="tick" x="{x:.1f}" y="{top - 8}" text-anchor="middle">{escape(command)}</text>')
    return labels


def layer_bar(layers: dict[str, int]) -> str:
    """One bar: the bytes of all links by layer, with a legend below."""
    total = sum(layers.values()) or 1
    parts, legend = [], []
    x = 0.0
    known = [name for name in LAYERS if layers.get(name)]
    for index, name in enumerate(known):
        width = layers[name] / total * WIDTH
        share = 100 * layers[name] / total
        title = f"<title>{name}: {layers[name]:,} bytes, {share:.1f} %</title>"
        parts.append(f'<rect class="s{index}" x="{x:.1f}" y="4" width="{width:.1f}" height="34">{title}</rect>')
        legend_x = index * WIDTH / len(known)
        legend.append(
            f'<rect class="s{index}" x="{legend_x:.0f}" y="52" width="12" height="12"/>'
            f'<text class="label" x="{legend_x + 18:.0f}" y="62">{name} {share:.1f} %</text>'
        )
        x += width
    return _svg(72, "Bytes by layer", parts + legend)


def _x(at_s: float, end_s: float) -> float:
    return _LEFT + max(0.0, at_s) / max(end_s, 1e-9) * (WIDTH - _LEFT - _RIGHT)


def _time_axis(end_s: float, y: float) -> str:
    step = 5 if end_s <= 60 else 10 if end_s <= 150 else 30
    ticks = range(0, int(end_s) + 1, step)
    return "".join(
        f'<text class="tick" x="{_x(t, end_s):.1f}" y="{y + 18}" text-anchor="middle">{t} s</text>' for t in ticks
    )


def _svg(height: float, label: str, parts: list[str]) -> str:
    return (
        f'<svg viewBox="0 0 {WIDTH} {height:.0f}" role="img" aria-label="{escape(label)}">'
        f"<title>{escape(label)}</title>{''.join(parts)}</svg>"
    )
