"""The parts of the bytes, by layer or by purpose: a bar per side."""

from __future__ import annotations

from collections.abc import Sequence

from ....numbers import words
from ....plan import wording
from .axes import Scale, lines_of, shade_legend
from .draw import Drawing, width_of
from .figure import Figure

Parts = dict[str, dict[str, int]]
"""By protocol the bytes of each part."""


def parts(name: str, title: str, note: str, order: Sequence[str], sides: Parts) -> Figure | None:
    """The figure of parts; None without bytes. `order` has the parts from left to right, at most seven."""
    totals = {p: sum(by.values()) for p, by in sides.items() if sum(by.values())}
    if not totals:
        return None
    used = [part for part in order if any(sides[p].get(part) for p in totals)]
    said = [
        f"{wording.name_of(p)} {words.size(total)}, most of it {max(used, key=lambda part: sides[p].get(part, 0))}"
        for p, total in totals.items()
    ]
    return Figure(
        name=name,
        title=title,
        shows=f"{title}: {'; '.join(said)}.",
        note=note,
        draw=lambda width: _draw(sides, totals, list(order), used, width),
        header=("protocol", "part", "bytes", "share"),
        rows=tuple(
            (p, part, sides[p].get(part, 0), round(sides[p].get(part, 0) / total, 6))
            for p, total in totals.items()
            for part in used
        ),
        sources=("pcap",),
    )


def _draw(sides: Parts, totals: dict[str, int], order: list[str], used: list[str], width: float) -> Drawing:
    bar, gap = 30.0, 30.0
    most = max(totals.values())
    shades = {part: f"l{order.index(part)}" for part in used}
    top = 10.0 + 20 * lines_of(shades, width)
    drawing = Drawing(width, top + len(totals) * (bar + gap + 14) - 12)
    shade_legend(drawing, shades)
    for number, (protocol, total) in enumerate(totals.items()):
        y = top + number * (bar + gap + 14) + 18
        drawing.text(0, y - 6, wording.name_of(protocol), protocol, bold=True)
        drawing.text(width, y - 6, words.size(total), "ink", "end")
        share = Scale(0, total, 0, width)
        done = 0
        for part in used:
            count = sides[protocol].get(part, 0)
            if not count:
                continue
            x, end = share(done), share(done + count)
            tip = f"{wording.name_of(protocol)}, {part}: {words.size(count)}, {words.percent(100 * count / total)}"
            drawing.rect(x, y, max(end - x - 1, 0.5), bar, f"l{order.index(part)}", tip=tip)
            label = words.percent(100 * count / total)
            if end - x > width_of(label) + 10:
                drawing.text(x + 6, y + bar / 2 + 4.5, label, "paper" if order.index(part) < 2 else "ink")
            done += count
        drawing.rect(0, y + bar + 4, max(width * total / most, 1.5), 3, protocol)
    return drawing
