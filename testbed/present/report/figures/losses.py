"""Frames lost on each link, by cause."""

from __future__ import annotations

from dataclasses import dataclass

from ....numbers import words
from ....plan import wording
from .axes import Scale, bottom, legend, lines_of, shade_legend, steps
from .draw import TEXT, Drawing, width_of
from .figure import Figure

CAUSES = {
    "random": "drawn at random",
    "queue": "no room in the queue",
    "closed": "link closed",
    "overload": "shaper overloaded",
    "corrupted": "a bit was turned",
    "unknown": "cause unknown",
}
_SHADES = {"random": "l1", "queue": "l2", "closed": "l0", "overload": "bad", "corrupted": "l3", "unknown": "l5"}


@dataclass(frozen=True)
class Lost:
    """The frames that entered one directed link, and by cause those of them that were lost."""

    entered: int
    by_cause: dict[str, int]

    @property
    def frames(self) -> int:
        return sum(self.by_cause.values())

    @property
    def share(self) -> float:
        return self.frames / self.entered if self.entered else 0.0


Links = dict[str, dict[str, Lost]]
"""By protocol and directed link."""


def losses(sides: Links, since_start: bool) -> Figure | None:
    """The figure of losses; None if nothing was lost, for which there is a sentence instead.

    `since_start`: counted since the links' start, else in the whole run.
    """
    names = [name for name in _names(sides) if any(links[name].frames for links in sides.values() if name in links)]
    if not names:
        return None
    causes = [c for c in CAUSES if any(one.by_cause.get(c) for links in sides.values() for one in links.values())]
    return Figure(
        name="loss",
        title="Loss by cause",
        shows=f"Share of the frames that entered each link and did not leave it. {said(sides)}",
        note=(
            "Of the frames that entered a link, those that never left it, "
            + (
                "from the links' start to the end of the captures"
                if since_start
                else "in the whole run, probes included"
            )
            + "; the number behind a bar is how many of how many. Links on which nothing was lost are left out. Up is "
            "towards the cloud."
        ),
        draw=lambda width: _draw(sides, names, causes, width),
        header=("protocol", "link", "entered", *CAUSES),
        rows=tuple(
            (protocol, name, links[name].entered, *(links[name].by_cause.get(cause, 0) for cause in CAUSES))
            for protocol, links in sides.items()
            for name in _names(sides)
            if name in links
        ),
        sources=("pcap", "links"),
    )


def said(sides: Links) -> str:
    """'Frames lost: over MQTT-XT 12 of 1,742 (8 no room in the queue and 4 drawn at random).'"""
    parts = []
    for protocol, links in sides.items():
        entered = sum(one.entered for one in links.values())
        sums = {cause: sum(one.by_cause.get(cause, 0) for one in links.values()) for cause in CAUSES}
        each = wording.listed([f"{count:,} {CAUSES[cause]}" for cause, count in sums.items() if count])
        detail = f" ({each})" if each else ""
        parts.append(f"over {wording.name_of(protocol)} {sum(sums.values()):,} of {entered:,}{detail}")
    return f"Frames lost: {wording.listed(parts)}."


def _names(sides: Links) -> list[str]:
    return list(dict.fromkeys(name for links in sides.values() for name in links))


def _draw(sides: Links, names: list[str], causes: list[str], width: float) -> Drawing:
    bar, left = 13.0, 128.0
    row = len(sides) * (bar + 2) + 10
    shades = {CAUSES[cause]: _SHADES[cause] for cause in causes}
    top = 30.0 + 20 * lines_of(shades, width)
    drawing = Drawing(width, top + row * len(names) + 22)
    legend(drawing, list(sides))
    shade_legend(drawing, shades, 20)
    most = max(links[name].share for links in sides.values() for name in names if name in links)
    room = width_of("100 % (10,000 of 100,000)" if width > 600 else "0 of 10,000", TEXT - 1)
    share = Scale(0, most, left, width - room)
    ticks = steps(100 * most, lambda v: f"{v:g} %", 5 if width > 600 else 3)
    bottom(drawing, share, [(value / 100, name) for value, name in ticks], top + row * len(names) - 4, top - 4)
    for number, name in enumerate(names):
        y = top + number * row
        drawing.text(left - 22, y + row / 2 - 1, name, "soft", "end", TEXT - 0.5)
        for order, (protocol, links) in enumerate(sides.items()):
            at = y + order * (bar + 2)
            drawing.dot((left - 12, at + bar / 2), protocol, 3.2)
            one = links.get(name, Lost(0, {}))
            x = left
            for cause in causes:
                count = one.by_cause.get(cause, 0)
                if count:
                    end = share((sum(one.by_cause.get(c, 0) for c in causes[: causes.index(cause) + 1])) / one.entered)
                    tip = f"{wording.name_of(protocol)}, {name}: {count:,} of {one.entered:,}, {CAUSES[cause]}"
                    drawing.rect(x, at, max(end - x, 0.8), bar, _SHADES[cause], tip=tip)
                    x = end
            told = f"{words.percent(100 * one.share)}" if one.frames else f"0 of {one.entered:,}"
            told += f" ({one.frames:,} of {one.entered:,})" if one.frames and width > 600 else ""
            drawing.text(x + 6, at + bar - 2.5, told, "soft", size=TEXT - 1)
        drawing.line((left, y - 3), (left, y + row - 7), "faint")
    return drawing
