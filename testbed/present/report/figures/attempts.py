"""Attempts as points: the time of each mission; packets and bytes of each scenario beside the thesis's."""

from __future__ import annotations

from dataclasses import dataclass

from ....numbers import quantity, words
from ....plan import wording
from .axes import Scale, bottom, decades, legend, log_bounds, side, steps
from .draw import TEXT, Drawing
from .figure import Figure, Value


@dataclass(frozen=True)
class MissionTime:
    """One attempt: its mission time in seconds, None if it failed or is void, and the reason."""

    attempt: int
    seconds: float | None
    status: str
    reason: str | None


Times = dict[str, quantity.QuantityFigure]
"""Mission times by protocol."""


def mission_time(sides: dict[str, list[MissionTime]], times: Times, printed: dict[str, float]) -> Figure | None:
    """The figure of mission times; None if no mission was completed. `printed` are the thesis's means."""
    flown = {protocol: one for protocol, one in times.items() if one.points}
    if not flown:
        return None
    said = [f"{wording.name_of(p)} {one.text} (median of {len(one.points)})" for p, one in flown.items()]
    bounds = any(one.interval for one in flown.values())
    return Figure(
        name="mission-time",
        title="Mission time of each attempt",
        shows=f"Seconds from the first arm command to the last disarming: {wording.listed(said)}.",
        note=(
            "Each mark is an attempt; a cross on top is one that failed or is void. At the right: the median (stroke), "
            "the mean (hollow)"
            + (", its 95 % bootstrap interval (bar)" if bounds else "")
            + (" and the mean that the thesis printed (dotted)." if printed else ".")
            + ("" if bounds else " An interval is given from six attempts on.")
        ),
        draw=lambda width: _draw_missions(sides, flown, printed, width),
        header=("protocol", "attempt", "status", "mission_s", "reason"),
        rows=tuple(
            (p, one.attempt, one.status, one.seconds, wording.first_line(one.reason) if one.reason else None)
            for p, missions in sides.items()
            for one in missions
        ),
        sources=("pcap", "sitl"),
    )


def _draw_missions(
    sides: dict[str, list[MissionTime]], times: Times, printed: dict[str, float], width: float
) -> Drawing:
    left, top, high = 46.0, 44.0, 170.0
    right = width - (150 if width > 600 else 84)
    drawing = Drawing(width, top + high + 40)
    legend(drawing, list(sides))
    longest = max([value for one in times.values() for value in one.points] + list(printed.values()))
    up = Scale(0, longest * 1.06, top + high, top)
    side(drawing, up, steps(longest, lambda v: f"{v:g} s", 5), left, right)
    last = max(one.attempt for missions in sides.values() for one in missions)
    across = Scale(0.5, last + 0.5, left, right - 20)
    every = max(1, round(last / 12))
    bottom(drawing, across, [(float(n), str(n)) for n in range(1, last + 1, every)], top + high)
    drawing.text((left + right) / 2, top + high + 34, "attempt", "soft", "middle")
    for order, (protocol, missions) in enumerate(sides.items()):
        nudge = (order - (len(sides) - 1) / 2) * min(12.0, (across(2) - across(1)) / 3 if last > 1 else 12.0)
        for one in missions:
            x = across(one.attempt) + nudge
            if one.seconds is not None:
                tip = f"{wording.name_of(protocol)}, attempt {one.attempt}: {words.seconds(one.seconds)}"
                drawing.dot((x, up(one.seconds)), protocol, 4.2, tip=tip)
            else:
                why = wording.first_line(one.reason)
                tip = f"{wording.name_of(protocol)}, attempt {one.attempt}: {one.status}, {why}"
                for turn in (-1, 1):
                    drawing.path([(x - 4, top - 12 - 4 * turn), (x + 4, top - 12 + 4 * turn)], "bad", 2, tip=tip)
        x = right + 8 + order * (66 if width > 600 else 38)
        if protocol in times:
            middle, mean, interval = times[protocol].value or 0.0, times[protocol].mean or 0.0, times[protocol].interval
            if interval:
                drawing.rect(x, up(interval[1]), 10, max(up(interval[0]) - up(interval[1]), 1.5), protocol, 0.35)
            drawing.line((x - 3, up(middle)), (x + 13, up(middle)), protocol, 2.6)
            drawing.dot((x + 5, up(mean)), protocol, 3.4, hollow=True)
            drawing.text(x + 17, up(middle) + 4, f"{middle:.0f} s" if width > 600 else f"{middle:.0f}", protocol)
        if protocol in printed:
            y = up(printed[protocol])
            drawing.path([(left, y), (right - 4, y)], protocol, 1, dashed=True)
            drawing.text(left + 4, y - 4, f"thesis {printed[protocol]:g} s", protocol, size=TEXT - 1.5)
    return drawing


@dataclass(frozen=True)
class ScenarioAmount:
    """An amount of a scenario over a protocol: measured here, by attempt, and from the thesis."""

    here: tuple[float, ...]
    thesis: float | None


Scenarios = dict[str, dict[str, ScenarioAmount]]
"""By scenario and protocol."""


def scenarios(packets: Scenarios, sizes: Scenarios, slips: frozenset[tuple[str, str]]) -> Figure | None:
    """The figure of each scenario's packets and bytes; None if nothing was measured. `slips` are the (scenario,
    protocol) whose printed bytes are known to be wrong.
    """
    if not any(amount.here for by in packets.values() for amount in by.values()):
        return None
    rows: list[tuple[Value, ...]] = []
    for what, by_scenario in (("packets", packets), ("bytes", sizes)):
        for name, by in by_scenario.items():
            for protocol, amount in by.items():
                rows += [(what, name, protocol, f"attempt {n}", value) for n, value in enumerate(amount.here, 1)]
                if amount.thesis is not None:
                    rows.append((what, name, protocol, "thesis, mean of 10", amount.thesis))
    return Figure(
        name="scenarios",
        title="Packets and bytes of each scenario",
        shows="Packets and bytes of every scenario: measured here beside what the thesis printed.",
        note=(
            "Filled: measured here, a mark an attempt. Hollow: what the thesis printed, means of ten. Both scales are "
            "logarithmic." + (" Struck through: a figure that the thesis's own packets contradict." if slips else "")
        ),
        draw=lambda width: _draw_scenarios(packets, sizes, slips, width),
        header=("what", "scenario", "protocol", "source", "value"),
        rows=tuple(rows),
        sources=("pcap",),
    )


def _draw_scenarios(packets: Scenarios, sizes: Scenarios, slips: frozenset[tuple[str, str]], width: float) -> Drawing:
    narrow = width < 600
    row, top = 40.0, 48.0
    left, gap = (66.0 if narrow else 84.0), 40.0
    high = row * len(packets)
    panels = (("packets", packets, words.short, frozenset[tuple[str, str]]()), ("bytes", sizes, words.tick_size, slips))
    drawing = Drawing(width, (top + high + 26) * (2 if narrow else 1) + (0 if narrow else 4))
    protocols = dict.fromkeys(p for by in packets.values() for p in by)
    legend(drawing, list(protocols))
    wide = width - left - 14 if narrow else (width - left - gap - 14) / 2
    for number, (title, by_scenario, name, struck) in enumerate(panels):
        x = left if narrow else left + number * (wide + gap)
        y = top + (number * (top + high + 8) if narrow else 0)
        values = [v for by in by_scenario.values() for a in by.values() for v in (*a.here, a.thesis or 0)]
        low, most = log_bounds(values)
        across = Scale(low, most, x, x + wide, logarithmic=True)
        drawing.text(x, y - 12, title, "ink", bold=True)
        bottom(drawing, across, decades(low, most, name, 4), y + high - 6, y - 4)
        for place, (scenario, by) in enumerate(by_scenario.items()):
            middle = y + place * row + row / 2 - 6
            if number == 0 or narrow:
                drawing.text(left - 10, middle + 4, wording.short_name(scenario, narrow), "ink", "end")
            for order, (protocol, amount) in enumerate(by.items()):
                at = middle + (order - (len(by) - 1) / 2) * 13
                if amount.thesis is not None:
                    tip = f"thesis, {scenario}, {wording.name_of(protocol)}: {amount.thesis:,.0f} {title}"
                    drawing.dot((across(amount.thesis), at), protocol, 4, hollow=True, tip=tip)
                    if (scenario, protocol) in struck:
                        centre = across(amount.thesis)
                        drawing.line((centre - 8, at), (centre + 8, at), "bad", 2)
                for value in amount.here:
                    tip = f"here, {scenario}, {wording.name_of(protocol)}: {value:,.0f} {title}"
                    drawing.dot((across(value), at), protocol, 4, tip=tip)
            drawing.line((x, y + (place + 1) * row - 6), (x + wide, y + (place + 1) * row - 6), "edge")
    return drawing
