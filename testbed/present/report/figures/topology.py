"""The nodes and the links between them, with each link's measurements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ....numbers import words
from ....plan import wording
from ..details import LinkFigure
from .draw import TEXT, Drawing
from .figure import Figure, Value

_SMALL = TEXT - 1.5
_WRITTEN = {"delay_ms": words.short_delay, "rate_bps": words.bit_rate, "loss": words.share}
"""The figures on a link, and how each is written."""

DirectionFigures = Mapping[str, LinkFigure]
"""One direction of a link: its known figures by name."""


@dataclass(frozen=True)
class DrawnLink:
    """A link from its lower to its upper node, and its two directions."""

    name: str
    lower: str
    upper: str
    up: DirectionFigures
    down: DirectionFigures


def topology(links: list[DrawnLink], profile: str, shaper: str) -> Figure | None:
    """The figure of nodes and links; None without links."""
    if not links:
        return None
    measured = any(_label(way, True) for link in links for way in (link.up, link.down))
    known = any(_label(way, False) for link in links for way in (link.up, link.down))
    shaped = "nothing is shaped" if shaper == "none" else f"shaped by {shaper}"
    told = "as measured by probes before the run" if measured else "as configured" if known else "without figures"
    return Figure(
        name="topology",
        title="Nodes and links",
        shows=f"{wording.plural(len(links), 'link')} of profile {profile}, {shaped}, {told}.",
        note=(
            f"Profile {profile}, {shaped}. ↑ is towards the cloud. "
            + (
                "Delay one way and rate as probes measured them before the run, loss as it was counted in the run."
                if measured
                else "Delay one way, rate and loss as they were configured."
                if known
                else "No link was shaped, so there is nothing to write on them."
            )
        ),
        draw=lambda width: _draw_list(links, measured, width) if width < 600 else _draw_tree(links, measured, width),
        header=("link", "way", "from", "to", *(f"{n}_{k}" for n in _WRITTEN for k in ("configured", "measured"))),
        rows=tuple(row for link in links for row in _rows(link)),
        sources=("links", "manifest.json"),
    )


def _rows(link: DrawnLink) -> list[tuple[Value, ...]]:
    rows: list[tuple[Value, ...]] = []
    ends = ((link.lower, link.upper), (link.upper, link.lower))
    for direction, way, (start, end) in zip(("up", "down"), (link.up, link.down), ends, strict=True):
        figures: list[Value] = []
        for name in _WRITTEN:
            figures += [way[name].configured, way[name].measured] if name in way else [None, None]
        rows.append((link.name, direction, start, end, *figures))
    return rows


def _label(way: DirectionFigures, measured: bool) -> str:
    """'25 ms · 20 Mbit/s · 1 %', without figures that are unknown or zero."""
    known = {name: one.measured if measured else one.configured for name, one in way.items()}
    return " · ".join(write(value) for name, write in _WRITTEN.items() if (value := known.get(name)))


def _children(links: list[DrawnLink]) -> dict[str, list[DrawnLink]]:
    found: dict[str, list[DrawnLink]] = {}
    for link in links:
        found.setdefault(link.upper, []).append(link)
    return found


def _draw_tree(links: list[DrawnLink], measured: bool, width: float) -> Drawing:
    """Draw the ground station on the left and the drones on the right; a row for each node with none below it."""
    children = _children(links)
    root = next(link.upper for link in links if link.upper not in {other.lower for other in links})
    station = next((link for link in children[root] if link.lower not in children and link.lower == "gs"), None)
    depths: dict[str, int] = {root: 1 if station else 0}
    order: list[DrawnLink] = []

    def walk(node: str) -> None:
        for link in children.get(node, []):
            if link is not station:
                depths[link.lower] = depths[node] + 1
                order.append(link)
                walk(link.lower)

    walk(root)
    deepest = max(depths.values())
    step = (width - 100) / deepest
    row, top = 46.0, 26.0
    heights: dict[str, float] = {}
    leaves = [link.lower for link in order if link.lower not in children]
    for number, leaf in enumerate(leaves):
        heights[leaf] = top + number * row
    for link in [*reversed(order), DrawnLink("", root, "", {}, {})]:
        below = [heights[child.lower] for child in children.get(link.lower, []) if child is not station]
        if below:
            heights[link.lower] = (min(below) + max(below)) / 2
    drawing = Drawing(width, top + row * max(len(leaves) - 1, 1) + 26)
    place = {node: (24 + depth * step, heights[node]) for node, depth in depths.items()}
    if station:
        place[station.lower] = (24.0, heights[root])
        drawing.path([place[station.lower], place[root]], "faint", 1.3)
        _draw_labels(drawing, station, place[station.lower][0] + 14, heights[root], measured)
    for link in order:
        (x, y), (to_x, to_y) = place[link.upper], place[link.lower]
        bend = x + (34 if step > 240 else 16)
        drawing.path([(x, y), (bend, y), (bend, to_y), (to_x, to_y)], "faint", 1.3)
        _draw_labels(drawing, link, bend + 6, to_y, measured)
    for node, (x, y) in place.items():
        drawing.dot((x, y), "ink", 5)
        outer = node in leaves
        drawing.text(
            x + 11 if outer else x, y + 4 if outer else y - 13, node, "ink", "start" if outer else "middle", bold=True
        )
    return drawing


def _draw_labels(drawing: Drawing, link: DrawnLink, x: float, y: float, measured: bool) -> None:
    up, down = _label(link.up, measured), _label(link.down, measured)
    if up:
        drawing.text(x, y - 5, f"↑ {up}", "soft", size=_SMALL)
    if down:
        drawing.text(x, y + 14, f"↓ {down}", "soft", size=_SMALL)


def _draw_list(links: list[DrawnLink], measured: bool, width: float) -> Drawing:
    """Draw the tree from the cloud down, a row per node, for phones."""
    children = _children(links)
    root = next(link.upper for link in links if link.upper not in {other.lower for other in links})
    rows: list[tuple[DrawnLink | None, str, int]] = [(None, root, 0)]

    def walk(node: str, depth: int) -> None:
        for link in children.get(node, []):
            rows.append((link, link.lower, depth))
            walk(link.lower, depth + 1)

    walk(root, 1)
    row, top, indent = 36.0, 16.0, 20.0
    drawing = Drawing(width, top + row * len(rows) - 6)
    place = {node: (8 + indent * depth, top + row * number) for number, (_, node, depth) in enumerate(rows)}
    for link, node, _ in rows:
        x, y = place[node]
        if link is not None:
            above_x, above_y = place[link.upper]
            drawing.path([(above_x, above_y), (above_x, y), (x, y)], "faint", 1.3)
            up, down = _label(link.up, measured), _label(link.down, measured)
            for said, shift in ((f"↑ {up}" if up else "", -3), (f"↓ {down}" if down else "", 11)):
                drawing.text(width - 4, y + shift, said, "soft", "end", _SMALL)
    for _, node, _ in rows:
        x, y = place[node]
        drawing.dot((x, y), "ink", 4.5)
        drawing.text(x + 10, y + 4, node, "ink", bold=True)
    return drawing
