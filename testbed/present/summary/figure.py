"""The ratios of an experiment as points: traffic and, for missions, time; a row per arm on each profile."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...numbers import words
from ...plan import wording
from ...plan.experiments import MESSAGES
from ..report import thesis
from ..report.figures.axes import Scale, bottom, decades, log_bounds
from ..report.figures.draw import TEXT, Drawing
from ..report.figures.figure import Figure
from .numbers import NumbersRow
from .overview import Block, Overview

_LINE, _HEADING = 21.0, 27.0
_COLUMNS = {"packets": "packets", "bytes": "bytes", "rate": "bytes_per_s", "mission": "mission_time"}
_TRAFFIC = "Traffic: filled, bytes; hollow, packets; pale, where one side completed no attempt, bytes a second."
_TIME = "Mission time: dashed, what the thesis claims."


def ratios(overview: Overview) -> Figure | None:
    """The figure of ratios; None if no cell has a ratio to draw."""
    flown = [(block, [row for row in block.rows if row.rate is not None]) for block in overview.blocks]
    blocks = [(block, rows) for block, rows in flown if rows]
    if not blocks:
        return None
    timed = overview.experiment != MESSAGES
    columns = [column for column in _COLUMNS if timed or column != "mission"]
    name = wording.short_name(overview.experiment)
    of_time = ", and how much shorter or longer the mission was over MQTT-XT" if timed else ""
    return Figure(
        name=f"ratios-{overview.experiment}",
        title=f"Ratios of {name}",
        shows=f"How many times MQTT-XT's packets and bytes MAVLink needed in {name}, by profile and arm{of_time}.",
        note=f"{_TRAFFIC} {_TIME}" if timed else _TRAFFIC,
        draw=lambda width: _draw(blocks, width, timed),
        header=("profile", "arm", *(_COLUMNS[column] for column in columns)),
        rows=tuple(
            (block.profile, row.arm, *(getattr(row, column) for column in columns))
            for block, rows in blocks
            for row in rows
        ),
        sources=("pcap",),
    )


Blocks = list[tuple[Block, list[NumbersRow]]]


@dataclass(frozen=True)
class _Panel:
    """A panel's scale, and the top and base of its rows."""

    across: Scale
    top: float
    base: float


def _draw(blocks: Blocks, width: float, timed: bool) -> Drawing:
    narrow = width < 600
    height = sum(_HEADING + _LINE * len(rows) for _, rows in blocks)
    left, top = (128.0 if narrow else 158.0), 40.0
    drawing = Drawing(width, (top + height + 28) * (2 if narrow and timed else 1))
    part = (width - left - 16) * (0.58 if timed and not narrow else 1)
    _traffic(drawing, blocks, _panel(drawing, blocks, left, left + part, top, "traffic, MAVLink over MQTT-XT"))
    if timed:
        second = left if narrow else left + part + 40
        lower = top + height + 28 + top if narrow else top
        title = "mission time, MQTT-XT against MAVLink"
        _missions(drawing, blocks, _panel(drawing, blocks, second, width - 16, lower, title, named=narrow))
    return drawing


def _panel(
    drawing: Drawing, blocks: Blocks, start: float, end: float, top: float, title: str, named: bool = True
) -> _Panel:
    """Draw a title and, with `named`, the profiles and arms on the left. The panel's scale is from 0 to 1."""
    drawing.text(0 if drawing.narrow else start, top - 22, title, "ink", bold=True)
    y = top
    for block, rows in blocks:
        drawing.line((0 if named else start, y), (end, y), "edge")
        if named:
            drawing.text(0, y + 18, f"profile {block.profile}", "ink", bold=True)
        y += _HEADING
        for row in rows:
            if named:
                drawing.text(8, y + 10, row.arm, "soft", size=TEXT - 0.5)
            y += _LINE
    return _Panel(Scale(0, 1, start, end), top, y)


def _traffic(drawing: Drawing, blocks: Blocks, panel: _Panel) -> None:
    values = [value for _, rows in blocks for row in rows for value in (row.packets, row.bytes, row.rate) if value]
    least, most = log_bounds([*values, 1.0])
    across = Scale(least, most, panel.across.start, panel.across.end, logarithmic=True)
    bottom(drawing, across, decades(least, most, lambda v: f"{v:g}×", 5), panel.base, panel.top)
    drawing.line((across(1), panel.top), (across(1), panel.base), "faint", 1.4)
    for profile, row, y in _rows(blocks, panel.top):
        where = f"{profile}, {row.arm}"
        if row.bytes is None or row.packets is None:
            drawing.dot((across(row.rate or 1), y), "faint", 4, tip=f"{where}: {words.ratio(row.rate)}× bytes a second")
            continue
        drawing.dot(
            (across(row.packets), y), "ink", 4, hollow=True, tip=f"{where}: {words.ratio(row.packets)}× packets"
        )
        drawing.dot((across(row.bytes), y), "ink", 4, tip=f"{where}: {words.ratio(row.bytes)}× bytes")


def _missions(drawing: Drawing, blocks: Blocks, panel: _Panel) -> None:
    times = [1 / row.mission for _, rows in blocks for row in rows if row.mission]
    step = 0.25 if max(times, default=1.0) < 2 else 1.0
    first = min(math.floor(min(times, default=1.0) / step), round(0.5 / step)) * step
    last = max(math.ceil(max(times, default=1.0) / step), round(1.25 / step)) * step
    across = Scale(first, last, panel.across.start, panel.across.end)
    shares = [first + step * number for number in range(round((last - first) / step) + 1)]
    bottom(drawing, across, [(one, _change(one)) for one in shares], panel.base, panel.top)
    drawing.line((across(1), panel.top), (across(1), panel.base), "faint", 1.4)
    claimed = across(1 - thesis.everything()["claims"]["mission_time_saving"])
    drawing.line((claimed, panel.top), (claimed, panel.base), "soft", 1.2, dashed=True)
    for profile, row, y in _rows(blocks, panel.top):
        if row.mission:
            time = 1 / row.mission
            drawing.dot((across(time), y), "ink", 4, tip=f"{profile}, {row.arm}: {_change(time)}")


def _change(time: float) -> str:
    percent = round(100 * (time - 1))
    return f"{'+' if percent > 0 else '−'}{abs(percent)} %" if percent else "0 %"


def _rows(blocks: Blocks, top: float) -> list[tuple[str, NumbersRow, float]]:
    """Each row with its profile and the y of its marks."""
    found, y = [], top
    for block, rows in blocks:
        y += _HEADING
        found += [(block.profile, row, y + _LINE * number + 6) for number, row in enumerate(rows)]
        y += _LINE * len(rows)
    return found
