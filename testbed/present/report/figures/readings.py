"""The sensors' values over time, those that arrived, and how long each took."""

from __future__ import annotations

from dataclasses import dataclass

from mqttxt.protocol.readings import UNITS

from ....numbers import words
from ....numbers.metrics.readings import MeasuredValue
from ....plan import wording
from ..readings import unit_of
from .axes import Scale, legend
from .delays import Delays, draw_shares
from .draw import TEXT, Drawing, width_of
from .figure import Figure, Value

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class DetailedReadings:
    """The values of one side's attempt in detail; `start_ns` is when its mission began."""

    measured: tuple[MeasuredValue, ...]
    start_ns: int

    def since_s(self, t_ns: int) -> float:
        return (t_ns - self.start_ns) / SECOND_NS

    def measured_s(self, one: MeasuredValue) -> float:
        return self.since_s(one.time_ms * 1_000_000)


ReadingsBySide = dict[str, DetailedReadings]
_Panel = tuple[str, int]
MOST_MARKS = 60
"""The most values of a series for which each one has a mark."""
KINDS = tuple(UNITS)
"""The order of the rows from the top; other kinds follow."""


def values(sides: ReadingsBySide) -> Figure | None:
    """The figure with a panel per kind and drone, one scale per kind; None if nothing was measured."""
    seen = {(one.kind, one.drone) for side in sides.values() for one in side.measured}
    panels = sorted(seen, key=lambda panel: (KINDS.index(panel[0]) if panel[0] in KINDS else len(KINDS), *panel))
    if not panels:
        return None
    arrived = {p: sum(one.told_ns is not None for one in side.measured) for p, side in sides.items()}
    counts = [f"{arrived[p]:,} of {len(side.measured):,} over {wording.name_of(p)}" for p, side in sides.items()]
    return Figure(
        name="readings",
        title="What the sensors measured, and what arrived",
        shows=f"Values of {len(panels)} series over time; arrived: {wording.listed(counts)}.",
        note=(
            "A row a kind, a column a drone; time runs since each side's mission began. The line is what the sensor "
            "wrote down itself, a mark a value that the ground station had as it was measured, a hollow red one a "
            "value that never came; of more than 60 values only such have a mark. Both sides "
            "flew at different times, so they measured different weather."
        ),
        draw=lambda width: _draw(sides, panels, width),
        header=(
            "protocol",
            "drone",
            "sensor",
            "kind",
            "unit",
            "measured_s",
            "value",
            "arrived_s",
            "delay_ms",
            "delay_app_ms",
        ),
        rows=tuple(_row(p, side, one) for p, side in sides.items() for one in side.measured),
        sources=("sensors", "events.jsonl", "pcap"),
    )


def delays(sides: ReadingsBySide) -> Figure | None:
    """The figure of the share of values that arrived within a time; None if none arrived."""
    kinds: dict[str, dict[str, Delays]] = {}
    for title, of in (("node to node, by capture", "delay_ms"), ("measured to told, by the program", "delay_app_ms")):
        for p, side in sides.items():
            took = tuple(getattr(one, of) for one in side.measured)
            if any(ms is not None for ms in took):
                kinds.setdefault(title, {})[p] = Delays(took, (1,) * len(took))
    if not kinds:
        return None
    return Figure(
        name="reading-delay",
        title="How long a value took to the ground station",
        shows="Share of the sensors' values that arrived within a time.",
        note=(
            "Read up from a time: that share of the values had arrived by then. On the left from its first frame "
            "leaving the sensor's node to its first copy reaching the ground station's, on the right from being "
            "measured to the ground station's program having it. What waits until a connection is up, as the first "
            "values after a drone has come near do, only shows on the right, and so do up to 50 ms until a sensor "
            "looks at its clock again."
        ),
        draw=lambda width: draw_shares(kinds, width),
        header=("from", "protocol", "delay_ms", "share_within"),
        rows=tuple(
            (title, p, ms, round((place + 1) / len(one.values), 6))
            for title, by in kinds.items()
            for p, one in by.items()
            for place, ms in enumerate(one.arrived)
        ),
        sources=("sensors", "events.jsonl", "pcap"),
    )


def _row(protocol: str, side: DetailedReadings, one: MeasuredValue) -> tuple[Value, ...]:
    arrived_s = None if one.told_ns is None else round(side.since_s(one.told_ns), 6)
    about = (protocol, one.drone, one.sensor, one.kind, one.unit, round(side.measured_s(one), 3), one.value)
    return (*about, arrived_s, _rounded(one.delay_ms), _rounded(one.delay_app_ms))


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _draw(sides: ReadingsBySide, panels: list[_Panel], width: float) -> Drawing:
    """Draw the panels; if the width is small, three drones are side by side and the others below them."""
    kinds, drones = list(dict.fromkeys(kind for kind, _ in panels)), sorted({drone for _, drone in panels})
    columns = min(len(drones), 3 if width < 600 else 6)
    groups = [drones[at : at + columns] for at in range(0, len(drones), columns)]
    left, gap, high, between, top = 46.0, 10.0, 58.0, 24.0, 22.0
    wide = (width - left - gap * (columns - 1)) / columns
    group = len(kinds) * (high + between) + 42
    drawing = Drawing(width, top + group * len(groups))
    legend(drawing, list(sides))
    times = [side.measured_s(one) for side in sides.values() for one in side.measured]
    for number, beside in enumerate(groups):
        y = top + number * group + 16 + between
        for place, kind in enumerate(kinds):
            low, most = _bounds(kind, sides)
            base = y + place * (high + between) + high
            up = Scale(low, most, base - 6, base - high + 8)
            unit = unit_of(_unit(kind, sides))
            for value in (low, most):
                drawing.text(left - 6, up(value) + 4, f"{value:.4g}", "faint", "end", TEXT - 1.5)
            drawing.text(left, base - high - 4, f"{kind}, {unit}", "ink", bold=True)
            for column, drone in enumerate(beside):
                x = left + column * (wide + gap)
                across = Scale(min(times), max(max(times), min(times) + 1), x + 4, x + wide - 4)
                drawing.rect(x, base - high, wide, high, "wash")
                for protocol, side in sides.items():
                    _draw_series(drawing, protocol, side, (kind, drone), across, up)
                if place == 0:
                    drawing.text(x + wide / 2, base - high - 22, f"drone {drone}", "soft", "middle")
                if place == len(kinds) - 1:
                    _draw_times(drawing, across, base)
    return drawing


def _draw_times(drawing: Drawing, across: Scale, base: float) -> None:
    first, last = f"{across.least:.0f} s", f"{across.most:.0f} s"
    drawing.text(across.start, base + TEXT + 2, first, "soft", size=TEXT - 1.5)
    if width_of(first + last) < across.end - across.start:
        drawing.text(across.end, base + TEXT + 2, last, "soft", "end", TEXT - 1.5)


def _draw_series(
    drawing: Drawing, protocol: str, side: DetailedReadings, panel: _Panel, across: Scale, up: Scale
) -> None:
    own = [one for one in side.measured if (one.kind, one.drone) == panel]
    places = [(across(side.measured_s(one)), up(one.value)) for one in own]
    drawing.path(places, protocol, 0.9)
    for one, at in zip(own, places, strict=True):
        if one.told_ns is not None and len(own) > MOST_MARKS:
            continue
        when = f"measured at {side.measured_s(one):.1f} s"
        came = "never came" if one.delay_app_ms is None else f"there after {words.milliseconds(one.delay_app_ms)}"
        what = f"{one.value:g} {unit_of(one.unit)}"
        tip = f"{wording.name_of(protocol)}, drone {one.drone}: {what}, {when}, {came}"
        drawing.dot(at, protocol if one.told_ns is not None else "bad", 2.4, hollow=one.told_ns is None, tip=tip)


def _bounds(kind: str, sides: ReadingsBySide) -> tuple[float, float]:
    """The least and the greatest value of a kind; never equal."""
    seen = [one.value for side in sides.values() for one in side.measured if one.kind == kind]
    return min(seen), max(max(seen), min(seen) + 1e-3)


def _unit(kind: str, sides: ReadingsBySide) -> str:
    return next(one.unit for side in sides.values() for one in side.measured if one.kind == kind)
