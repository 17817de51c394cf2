"""Delays of commands: each message by its number, and their distribution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ....numbers import words
from ....numbers.attempt_entry import AttemptEntry
from ....plan import wording
from .axes import Scale, bottom, decades, legend, log_bounds, quantile, side, steps
from .draw import Drawing
from .figure import Figure

LEAST_MS = 0.01


@dataclass(frozen=True)
class Delays:
    """One kind's one-way delays on one side, in order, with the attempt of each; milliseconds, None: lost."""

    values: tuple[float | None, ...]
    attempts: tuple[int, ...]
    by_application: tuple[float, ...] = ()
    """From the call to the callback, as measured by the applications."""
    lost: int = 0
    """How many never arrived and are not among `values`."""

    @property
    def arrived(self) -> list[float]:
        return sorted(value for value in self.values if value is not None)

    @property
    def sent(self) -> int:
        return len(self.values) + self.lost


DelaysByKind = dict[str, dict[str, Delays]]
"""By command, or kind of message, and protocol."""


def rows_by_number(kinds: DelaysByKind) -> tuple[tuple[str, str, int, int, float | None], ...]:
    """The rows of a figure's data: kind, protocol, attempt, the value's number over all attempts, and the value."""
    return tuple(
        (name, protocol, attempt, number, value)
        for name, by in kinds.items()
        for protocol, one in by.items()
        for number, (value, attempt) in enumerate(zip(one.values, one.attempts, strict=True), 1)
    )


def delays_of(completed: dict[str, list[AttemptEntry]], order: list[str]) -> DelaysByKind:
    """Collect the delays of each side's completed attempts; commands in the given order, others after them."""
    said = {name for attempts in completed.values() for one in attempts for name in one["delay_ms"]}
    names = [*(name for name in order if name in said), *sorted(said - set(order))]
    found: DelaysByKind = {}
    for name in names:
        for protocol, attempts in completed.items():
            told = [(ms, one["attempt"]) for one in attempts for ms in one["delay_ms"].get(name, ())]
            own = [ms for one in attempts for ms in one["delay_app_ms"].get(name, ())]
            if told:
                values, numbers = zip(*told, strict=True)
                sent = [one["messages"]["commands"] for one in attempts]
                lost = sum(counts[name]["lost"] for counts in sent if name in counts)
                found.setdefault(name, {})[protocol] = Delays(values, numbers, tuple(own), lost)
    return found


def by_number(kinds: DelaysByKind) -> Figure | None:
    """The figure with each delay as a point; None without delays."""
    if not kinds:
        return None
    return Figure(
        name="delay-by-number",
        title="Delay of each command",
        shows=f"One-way delay of every command message by its number. {medians(kinds)}",
        note=(
            "One way, by capture: the first frame leaving the ground station to the first copy reaching the drone, "
            "message after message, on a logarithmic scale. The bar at the right of each panel spans the middle half, "
            "its stroke is the median. A dashed line parts attempts."
        ),
        draw=lambda width: _panels(kinds, width, _draw_numbers, 150),
        header=("command", "protocol", "attempt", "number", "delay_ms"),
        rows=rows_by_number(kinds),
        sources=("pcap", "events.jsonl"),
    )


def distribution(kinds: DelaysByKind) -> Figure | None:
    """The figure of the share of messages that arrived within a time; None without delays."""
    if not kinds:
        return None
    own = any(one.by_application for by in kinds.values() for one in by.values())
    return Figure(
        name="delay-distribution",
        title="How delays are distributed",
        shows=f"Share of command messages that arrived within a time. {medians(kinds)}",
        note=(
            "Read up from a time: that share of the messages had arrived by then; a line that ends below 100 % lost "
            "the rest."
            + (" Thin and dashed: the applications' own, from the call to the callback, where one came." if own else "")
        ),
        draw=lambda width: _panels(kinds, width, _draw_shares, 130),
        header=("command", "protocol", "measured", "delay_ms", "share_within"),
        rows=tuple(
            (name, protocol, by, value, round((place + 1) / count, 6))
            for name, sides in kinds.items()
            for protocol, one in sides.items()
            for by, values, count in (
                ("capture", one.arrived, one.sent),
                ("application", sorted(one.by_application), len(one.by_application)),
            )
            for place, value in enumerate(values)
        ),
        sources=("pcap", "events.jsonl"),
    )


def draw_shares(kinds: DelaysByKind, width: float) -> Drawing:
    """Draw a panel for each of `kinds`, with the share of its messages that arrived within a time."""
    return _panels(kinds, width, _draw_shares, 130)


def medians(kinds: DelaysByKind) -> str:
    """'arm: median 3.00 ms over MQTT-XT and 1.00 ms over MAVLink; land: …'."""
    parts = []
    for name, by in kinds.items():
        each = [
            f"{words.milliseconds(quantile(one.arrived, 0.5))} over {wording.name_of(p)}"
            for p, one in by.items()
            if one.arrived
        ]
        parts.append(f"{name}: median {' and '.join(each)}")
    return f"{'; '.join(parts)}."


def middle_half(drawing: Drawing, x: float, up: Scale, ordered: Sequence[float], protocol: str, about: str) -> None:
    """Draw a bar over the middle half of the delays, with a stroke at their median."""
    ends = [up(quantile(ordered, part)) for part in (0.25, 0.75)]
    median = quantile(ordered, 0.5)
    tip = f"{about}: median {words.milliseconds(median)} of {len(ordered):,}"
    drawing.rect(x - 3, min(ends), 6, max(abs(ends[0] - ends[1]), 1.5), protocol, 0.45, tip)
    drawing.line((x - 5, up(median)), (x + 5, up(median)), protocol, 2.4)


def _panels(
    kinds: DelaysByKind, width: float, draw: Callable[[Drawing, dict[str, Delays], Scale, Scale], None], high: float
) -> Drawing:
    """Draw a panel per command, all with one scale of delays: side by side, or stacked if the width is small."""
    narrow = width < 600
    columns = 1 if narrow else min(len(kinds), 3)
    rows = -(-len(kinds) // columns)
    left, gap, top, tall = 52.0, 32.0, 44.0, high + 52
    drawing = Drawing(width, top + rows * tall - 14)
    protocols = dict.fromkeys(protocol for by in kinds.values() for protocol in by)
    legend(drawing, [p for p in wording.PROTOCOL_NAMES if p in protocols])
    values = [ms for by in kinds.values() for one in by.values() for ms in (*one.arrived, *one.by_application)]
    low, most = log_bounds(values, LEAST_MS)
    wide = (width - left - (columns - 1) * gap - 4) / columns
    for place, (name, by) in enumerate(kinds.items()):
        x = left + (place % columns) * (wide + gap)
        y = top + (place // columns) * tall
        drawing.text(x, y - 8, name, "ink", bold=True)
        first = place % columns == 0
        if draw is _draw_numbers:
            vertical = Scale(low, most, y + high, y + 2, logarithmic=True)
            side(drawing, vertical, decades(low, most, words.delay), x, x + wide, first)
            count = max(len(one.values) for one in by.values())
            horizontal = Scale(0, count + 1, x, x + wide - 34)
            ticks = [(at, label) for at, label in steps(count, lambda v: f"{v:.0f}", 4) if at.is_integer()]
            bottom(drawing, horizontal, [*((1.0, "1") for _ in range(count > 1)), *ticks[1:]] or ticks, y + high)
        else:
            horizontal = Scale(low, most, x, x + wide, logarithmic=True)
            ticks = decades(low, most, words.delay, 5 if narrow else 3)
            vertical = Scale(0, 1, y + high, y + 2)
            side(drawing, vertical, [(0, "0"), (0.5, "50 %"), (1, "100 %")], x, x + wide, first)
            bottom(drawing, horizontal, ticks, y + high, y + 2)
        draw(drawing, by, horizontal, vertical)
    return drawing


def _draw_numbers(drawing: Drawing, by: dict[str, Delays], across: Scale, up: Scale) -> None:
    for order, (protocol, one) in enumerate(by.items()):
        for number, (value, attempt) in enumerate(zip(one.values, one.attempts, strict=True), 1):
            tip = f"{wording.name_of(protocol)}, message {number} (attempt {attempt}): {words.milliseconds(value)}"
            if value is not None:
                drawing.dot((across(number), up(value)), protocol, 2.6 if len(one.values) > 40 else 3.2, tip=tip)
            if order == 0 and number > 1 and attempt != one.attempts[number - 2]:
                x = across(number - 0.5)
                drawing.line((x, up(up.least)), (x, up(up.most)), "faint", 0.8, dashed=True)
        middle_half(drawing, across.end + 12 + 14 * order, up, one.arrived, protocol, wording.name_of(protocol))


def _draw_shares(drawing: Drawing, by: dict[str, Delays], across: Scale, up: Scale) -> None:
    for protocol, one in by.items():
        _stairs(drawing, sorted(one.by_application), len(one.by_application), protocol, across, up, thin=True)
        _stairs(drawing, one.arrived, one.sent, protocol, across, up)


def _stairs(
    drawing: Drawing, values: Sequence[float], count: int, protocol: str, across: Scale, up: Scale, thin: bool = False
) -> None:
    points, share = [(across.start, up(0))], 0.0
    for place, value in enumerate(values, 1):
        points.append((across(value), up(share)))
        share = place / count
        points.append((across(value), up(share)))
    points.append((across.end, up(share)))
    if values:
        drawing.path(points, protocol, 1.1 if thin else 2.0, dashed=thin)
