"""The message set's delays: each message of a kind in order, with lost ones marked."""

from __future__ import annotations

from ....numbers import words
from ....numbers.attempt_entry import AttemptEntry
from ....plan import wording
from .axes import Scale, decades, log_bounds, quantile, side
from .delays import LEAST_MS, Delays, DelaysByKind, medians, middle_half, rows_by_number
from .draw import TEXT, Drawing, Point, width_of
from .figure import Figure
from .panels import Panel, begin, lay_out

MOST_DOTS = 120
"""The most messages of a side that are drawn as dots; more are drawn in groups."""
GROUPS = 60
_HIGH, _BELOW = 116.0, 62.0
_STRIP = 7.0
"""The height of each side's row of lost messages, above the delays."""


_LOST_NOTE = " A cross on top is a message that never arrived; of a group a bar, the darker the more of it were lost."


def delays_of(completed: dict[str, list[AttemptEntry]], order: tuple[str, ...]) -> DelaysByKind:
    """Collect the delays of each side's completed attempts, kinds in the given order."""
    found: DelaysByKind = {}
    for name in order:
        for protocol, attempts in completed.items():
            told = [
                (ms, one["attempt"])
                for one in attempts
                if (kind := (one["message_set"] or {}).get(name)) is not None
                for ms in kind["delay_ms"]
            ]
            if told:
                values, numbers = zip(*told, strict=True)
                found.setdefault(name, {})[protocol] = Delays(values, numbers)
    return found


def kind_delays(kinds: DelaysByKind) -> Figure | None:
    """The figure of delays by kind; None if nothing arrived."""
    if not any(one.arrived for by in kinds.values() for one in by.values()):
        return None
    grouped = any(len(one.values) > MOST_DOTS for by in kinds.values() for one in by.values())
    lost = any(None in one.values for by in kinds.values() for one in by.values())
    return Figure(
        name="delay-by-kind",
        title="Delay of each message in its order",
        shows=f"One-way delay of every message, kind by kind. {medians(kinds)}",
        note=(
            "One way, by capture, from leaving its origin to its first copy at the far end; the first message is left, "
            "the last one right, and below each panel is how many there were. All panels have one logarithmic scale. "
            "The bar at the right of each spans the middle half, its stroke is the median."
            + (
                f" More than {MOST_DOTS} messages of a side are drawn in {GROUPS} groups, in their order: a line from "
                "the least to the greatest, a dot at the median."
                if grouped
                else ""
            )
            + (_LOST_NOTE if lost else "")
        ),
        draw=lambda width: _draw(kinds, width),
        header=("kind", "protocol", "attempt", "number", "delay_ms"),
        rows=rows_by_number(kinds),
        sources=("pcap", "events.jsonl"),
    )


def _draw(kinds: DelaysByKind, width: float) -> Drawing:
    protocols = [p for p in wording.PROTOCOL_NAMES if any(p in by for by in kinds.values())]
    panels = lay_out(list(kinds), width, _HIGH, _BELOW)
    drawing = begin(panels, protocols, width, _BELOW)
    low, most = log_bounds([ms for by in kinds.values() for one in by.values() for ms in one.arrived], LEAST_MS)
    for panel in panels:
        up = Scale(low, most, panel.y + panel.high, panel.y + 2 + _STRIP * len(protocols), logarithmic=True)
        side(drawing, up, decades(low, most, words.delay, 5), panel.x, panel.x + panel.wide, panel.first)
        sides = list(enumerate(kinds[panel.name].items()))
        for order, (protocol, one) in sorted(sides, key=lambda side: -len(side[1][1].values)):  # the fewer on top
            _draw_side(drawing, panel, protocol, one, up, order)
        _count(drawing, panel, kinds[panel.name])
    return drawing


def _count(drawing: Drawing, panel: Panel, by: dict[str, Delays]) -> None:
    """Write the number of messages, and of lost ones, below the panel: a line per side if any was lost."""
    lost = {protocol: one.values.count(None) for protocol, one in by.items()}
    x, y = panel.x, panel.y + panel.high + TEXT + 5
    for protocol, one in by.items():
        said = f"{len(one.values):,}" + (f", {lost[protocol]:,} lost" if lost[protocol] else "")
        drawing.text(x, y, said, protocol, size=TEXT - 1)
        if any(lost.values()):
            y += TEXT + 1.5
        else:
            x += 12 + width_of(said, TEXT - 1)


def _draw_side(drawing: Drawing, panel: Panel, protocol: str, one: Delays, up: Scale, order: int) -> None:
    across = Scale(0, len(one.values) + 1, panel.x, panel.x + panel.wide - 30)
    lost_y = panel.y + 2 + _STRIP * order
    if len(one.values) <= MOST_DOTS:
        for number, (value, attempt) in enumerate(zip(one.values, one.attempts, strict=True), 1):
            about = f"{wording.name_of(protocol)}, {panel.name} {number} (attempt {attempt})"
            if value is None:
                _cross(drawing, (across(number), lost_y), protocol, f"{about}: lost")
            else:
                tip = f"{about}: {words.milliseconds(value)}"
                drawing.dot((across(number), up(value)), protocol, 2.2 if len(one.values) > 40 else 2.8, tip=tip)
    else:
        _draw_groups(drawing, panel, protocol, one, up, lost_y)
    if one.arrived:
        about = f"{wording.name_of(protocol)}, {panel.name}"
        middle_half(drawing, across.end + 10 + 13 * order, up, one.arrived, protocol, about)


def _draw_groups(drawing: Drawing, panel: Panel, protocol: str, one: Delays, up: Scale, lost_y: float) -> None:
    across = Scale(0, GROUPS, panel.x + 2, panel.x + panel.wide - 32)
    wide = across(1) - across(0)
    for group in range(GROUPS):
        first, until = (len(one.values) * edge // GROUPS for edge in (group, group + 1))
        values = sorted(value for value in one.values[first:until] if value is not None)
        lost = until - first - len(values)
        x = across(group + 0.5)
        about = f"{wording.name_of(protocol)}, {panel.name} {first + 1:,} to {until:,}"
        if lost:
            share = lost / (until - first)
            tip = f"{about}: {lost} lost, {words.share(share)}"
            drawing.rect(x - wide / 2, lost_y - 2.5, wide, 5, protocol, min(1.0, 0.15 + share), tip)
        if values:
            tip = f"{about}: {words.milliseconds(values[0])} to {words.milliseconds(values[-1])}"
            drawing.path([(x, up(values[0])), (x, up(values[-1]) - 0.5)], protocol, 1.2, tip=tip)
            drawing.dot((x, up(quantile(values, 0.5))), protocol, 1.3)


def _cross(drawing: Drawing, at: Point, protocol: str, tip: str) -> None:
    x, y = at
    for turn in (-1, 1):
        drawing.path([(x - 2.4, y - 2.4 * turn), (x + 2.4, y + 2.4 * turn)], protocol, 1.6, tip=tip)
