"""Common parts of figures: scales, ticks, legends, axes and grid lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from ....plan import wording
from .draw import TEXT, Drawing, width_of

Tick = tuple[float, str]
_OVER = 14.0
"""How many pixels the name of a tick may extend beyond its axis."""


@dataclass(frozen=True)
class Scale:
    """Maps values to pixels. A logarithmic scale maps values at or below `least` to the start."""

    least: float
    most: float
    start: float
    end: float
    logarithmic: bool = False

    def __call__(self, value: float) -> float:
        if self.logarithmic:
            part = math.log(max(value, self.least) / self.least) / math.log(self.most / self.least)
        else:
            part = (value - self.least) / ((self.most - self.least) or 1.0)
        return self.start + min(max(part, 0.0), 1.0) * (self.end - self.start)


def log_bounds(values: Sequence[float], least: float = 0.0) -> tuple[float, float]:
    """Bounds of whole decades around the positive values, at least one decade; `least` limits the lower bound."""
    positive = [value for value in values if value > 0]
    low = math.floor(math.log10(max(min(positive, default=1.0), least or 1e-12)) + 1e-9)
    high = math.ceil(math.log10(max(positive, default=10.0)) - 1e-9)
    return 10.0**low, 10.0 ** max(high, low + 1)


def decades(low: float, high: float, name: Callable[[float], str], most: int = 9) -> list[Tick]:
    """A tick for each power of ten, or for every second, third or sixth if there would be more than `most`."""
    first, last = round(math.log10(low)), round(math.log10(high))
    step = next(step for step in (1, 2, 3, 6) if (last - first) / step <= most)
    return [(10.0**power, name(10.0**power)) for power in range(first, last + 1, step)]


def steps(most: float, name: Callable[[float], str], count: int = 6) -> list[Tick]:
    """Ticks at round numbers from 0 to `most`, with at most `count` steps."""
    if most <= 0:
        return [(0.0, name(0.0))]
    unit = 10.0 ** math.floor(math.log10(most / count))
    step = next(unit * factor for factor in (1, 2, 5, 10, 20) if most / (unit * factor) <= count)
    return [(step * number, name(step * number)) for number in range(int(most / step + 1e-9) + 1)]


def clock(most_s: float, count: int = 8) -> list[Tick]:
    """Ticks of a time axis in seconds."""
    step = next((s for s in (1, 2, 5, 10, 20, 30, 60, 120, 300) if most_s / s <= count), 600)
    return [(float(t), f"{t} s") for t in range(0, int(most_s) + 1, step)]


def legend(drawing: Drawing, protocols: Sequence[str]) -> None:
    """Draw mark and name of each side on a line at the top."""
    x, y = 0.0, 13.0
    for protocol in protocols:
        drawing.dot((x + 4, y - 4), protocol, 3.6)
        drawing.text(x + 13, y, wording.name_of(protocol), protocol, bold=True)
        x += 13 + width_of(wording.name_of(protocol)) + 22


def shade_legend(drawing: Drawing, shades: Mapping[str, str], y: float = 0.0) -> None:
    """Draw each name with a square of its shade, from `y` down."""
    for name, x, line in _placed(shades, drawing.width):
        drawing.rect(x, y + 4 + 20 * line, 11, 11, shades[name])
        drawing.text(x + 17, y + 14 + 20 * line, name)


def lines_of(shades: Mapping[str, str], width: float) -> int:
    """The number of lines, 20 pixels each, that `shade_legend` takes."""
    return _placed(shades, width)[-1][2] + 1


def _placed(names: Iterable[str], width: float) -> list[tuple[str, float, int]]:
    """The x and line of each name, with as many on a line as fit."""
    found, x, line = [], 0.0, 0
    for name in names:
        needed = 17 + width_of(name) + 18
        if x + needed > width and x:
            x, line = 0.0, line + 1
        found.append((name, x, line))
        x += needed
    return found


def bottom(drawing: Drawing, scale: Scale, ticks: Sequence[Tick], y: float, top: float | None = None) -> None:
    """Draw a horizontal axis; with `top`, grid lines up to it. Names of ticks stay within the axis."""
    for value, name in ticks:
        x = scale(value)
        if top is not None:
            drawing.line((x, top), (x, y), "edge")
        half = width_of(name) / 2
        first, last = x - half < scale.start - _OVER, x + half > scale.end + _OVER
        anchor = "start" if first else "end" if last else "middle"
        drawing.text(x - 2 if first else x + 2 if last else x, y + TEXT + 4, name, anchor=anchor)


def side(drawing: Drawing, scale: Scale, ticks: Sequence[Tick], left: float, right: float, named: bool = True) -> None:
    """Draw horizontal grid lines, with their names on the left."""
    for value, name in ticks:
        y = scale(value)
        drawing.line((left, y), (right, y), "edge")
        if named:
            drawing.text(left - 6, y + 4, name, anchor="end")


def quantile(ordered: Sequence[float], part: float) -> float:
    """The quantile `part` of ordered values, by linear interpolation."""
    place = part * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (place - low) * (ordered[high] - ordered[low])
