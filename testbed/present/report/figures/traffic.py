"""Traffic over time: bytes per second on each link, the load of each fog, and the total load."""

from __future__ import annotations

from ....numbers import words
from ....plan import wording
from .axes import Scale, bottom, clock, decades, legend, log_bounds, side
from .draw import TEXT, Drawing
from .figure import Figure

Rates = dict[str, tuple[int, ...]]
"""By name the bytes in each second."""
_LEAST = 10.0
_HIGH = 74.0


def traffic(links: dict[str, Rates], loads: dict[str, Rates], seconds: dict[str, float]) -> Figure | None:
    """The figure of bytes per second on each link, and of L(x) of each fog and their total, by equations (1) and (2).

    All arguments are by protocol; `links` has directed links. `seconds` is how long each mission took: an incomplete
    last second is in the data, not in the lines. None if nothing was sent.
    """
    shown = {p: _both_ways(rates) for p, rates in links.items()}
    names = list(dict.fromkeys(name for rates in shown.values() for name in rates))
    panels = {name: {p: rates[name] for p, rates in shown.items() if name in rates} for name in names}
    for name in dict.fromkeys(name for rates in loads.values() for name in rates):
        title = "total load" if name == "total" else f"load of {name}"
        panels[title] = {p: rates[name] for p, rates in loads.items() if name in rates}
    if not any(any(values) for by in panels.values() for values in by.values()):
        return None
    return Figure(
        name="traffic",
        title="Traffic over time",
        shows=f"Bytes a second on {wording.plural(len(names), 'link')}, both ways together, by second of the mission.",
        note=(
            "Frame bytes that entered a link in each second, both ways together, on a logarithmic scale; a second "
            "without traffic is on the lowest line. "
            + ("A fog's load is what crosses it to and from its drones; the total is their sum. " if loads else "")
            + "The data have each way by itself."
        ),
        draw=lambda width: _draw(panels, seconds, width),
        header=("protocol", "link", "second", "bytes"),
        rows=tuple(
            (protocol, name, second, value)
            for of, prefix in ((links, ""), (loads, "load:"))
            for protocol, rates in of.items()
            for name, values in ((f"{prefix}{key}", values) for key, values in rates.items())
            for second, value in enumerate(values)
        ),
        sources=("pcap",),
    )


def _both_ways(rates: Rates) -> Rates:
    found: Rates = {}
    for name, values in rates.items():
        link = name.rsplit(":", 1)[0]
        found[link] = tuple(a + b for a, b in zip(found[link], values, strict=True)) if link in found else values
    return found


def _draw(panels: dict[str, dict[str, tuple[int, ...]]], seconds: dict[str, float], width: float) -> Drawing:
    narrow = width < 600
    columns = 1 if narrow else 3
    left, gap, top = 62.0, 36.0, 44.0
    high = 56.0 if narrow else _HIGH
    tall = high + 34
    rows = -(-len(panels) // columns)
    drawing = Drawing(width, top + rows * tall + 2)
    protocols = dict.fromkeys(protocol for by in panels.values() for protocol in by)
    legend(drawing, list(protocols))
    longest = max(len(values) for by in panels.values() for values in by.values())
    low, most = log_bounds([value for by in panels.values() for values in by.values() for value in values], _LEAST)
    low = max(low, _LEAST)
    wide = (width - left - (columns - 1) * gap - 14) / columns
    for place, (name, by) in enumerate(panels.items()):
        x, y = left + (place % columns) * (wide + gap), top + (place // columns) * tall
        drawing.text(x, y - 8, name, "ink", bold=True, size=TEXT - 0.5)
        up = Scale(low, most, y + high, y, logarithmic=True)
        across = Scale(0, longest, x, x + wide)
        side(drawing, up, decades(low, most, words.rate, 3), x, x + wide, place % columns == 0)
        if place >= len(panels) - columns:
            bottom(drawing, across, clock(longest, 4), y + high)
        for protocol, values in by.items():
            whole = values[: max(int(seconds.get(protocol, len(values))), 1)]
            points = [(across(second + part), up(value)) for second, value in enumerate(whole) for part in (0.0, 1.0)]
            drawing.path(points, protocol, 1.6)
    return drawing
