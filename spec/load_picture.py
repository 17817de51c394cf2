"""Load against drones: the measured runs, the costs fitted to them, bytes per hop, and delays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import log10
from typing import Any

from testbed.plan.documents import ROOT

from .scale import COMMANDS_EVERY_S, HOPS, MAVLINK, ROLES, costs, hops, needs, read_runs
from .svg import Drawing

_LEAST, _MOST = 10, 1000
"""The range of the logarithmic axis of drones."""
_LEFT, _RIGHT, _TOP, _BOTTOM, _APART = 60, 310, 50, 330, 325
_KINDS = ("mqttxt", "", "mavlink")
_STEPS = (10, 20, 50, 100, 200, 500, 1000)
_DOT = 7


def draw() -> Drawing:
    """Draw three panels, from the left: cores, kbit per second, delays."""
    drawing = Drawing(3 * _APART + 10, 420, "Load against drones")
    runs = read_runs()
    page = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    cost, apiece, mavlink = costs(runs), hops(page), hops(page, MAVLINK)[0]
    found = {drones: needs(drones, cost, apiece) for drones in _STEPS}
    cores = {name: [found[drones].cores[role] for drones in _STEPS] for role, name in ROLES.items()}
    place = _axes(drawing, 0, "% of a core", [100 * value for values in cores.values() for value in values])
    for kind, (name, values) in zip(_KINDS, cores.items(), strict=True):
        _curve(drawing, 0, place, [100 * value for value in values], name, kind)
    for run in runs:
        for kind, role in zip(_KINDS, ROLES, strict=True):
            x, y = _across(0, run["drones"]), place(100 * run["shares"][role])
            drawing.text(x, y + _DOT / 2, "●", f"{kind} small", "middle")
    kbit = {name: [8 * found[drones].bytes_s[hop] / 1000 for drones in _STEPS] for hop, name in enumerate(HOPS)}
    kbit["MAVLink, each hop"] = [8 * drones * mavlink / 1000 for drones in _STEPS]
    place = _axes(drawing, _APART, "kbit per second", [value for values in kbit.values() for value in values])
    for (name, values), lower in zip(kbit.items(), (74, 88, 70, -10), strict=True):
        _curve(drawing, _APART, place, values, name, "mavlink" if name.startswith("MAVLink") else "mqttxt", lower)
    _delays(drawing, 2 * _APART, runs)
    lines = "— by the costs fitted to all runs: 250 drones at a fog, a command to each every"
    drawing.text(_LEFT, 384, "● measured, with more fogs, and in some runs more commands", "small")
    drawing.text(_LEFT, 402, f"{lines} {COMMANDS_EVERY_S:g} s", "small")
    return drawing


def _delays(drawing: Drawing, left: float, runs: Sequence[dict[str, Any]]) -> None:
    """Draw each run's longest delay from a call to the autopilot, and its median where the run recorded it."""
    longest = [(run["drones"], 1000 * run["slowest_s"]) for run in runs]
    medians = [(run["drones"], 1000 * run["median_s"]) for run in runs if "median_s" in run]
    place = _axes(drawing, left, "ms from a call to the autopilot", [ms for _, ms in longest + medians])
    for dots, kind in ((longest, "mqttxt"), (medians, "")):
        for drones, ms in dots:
            drawing.text(_across(left, drones), place(ms) + _DOT / 2, "●", f"{kind} small", "middle")
    drawing.text(left + _LEFT, 384, "● longest of a run", "mqttxt small")
    if medians:
        drawing.text(left + _LEFT + 130, 384, "● median of a run", "small")


def _across(left: float, drones: float) -> float:
    return left + _LEFT + (_RIGHT - _LEFT) * log10(drones / _LEAST) / log10(_MOST / _LEAST)


def _axes(drawing: Drawing, left: float, title: str, values: Sequence[float]) -> Callable[[float], float]:
    """Draw both axes with their numbers; returns a value's y coordinate as a function."""
    lowest, highest = 10 ** int(log10(min(values)) // 1), 10 ** int(-(-log10(max(values)) // 1))

    def place(value: float) -> float:
        share = log10(max(value, lowest) / lowest) / log10(highest / lowest)
        return _BOTTOM - (_BOTTOM - _TOP) * share

    drawing.text(left + _LEFT, _TOP - 20, title, "title")
    drawing.line((left + _LEFT, _BOTTOM), (left + _RIGHT, _BOTTOM))
    drawing.line((left + _LEFT, _TOP), (left + _LEFT, _BOTTOM))
    for drones in _STEPS:
        drawing.text(_across(left, drones), _BOTTOM + 18, f"{drones:,}", "small", "middle")
    drawing.text(left + _RIGHT, _BOTTOM + 36, "drones", "small", "end")
    value = lowest
    while value <= highest:
        drawing.text(left + _LEFT - 6, place(value) + 4, f"{value:,g}", "small", "end")
        value *= 10
    return place


def _curve(
    drawing: Drawing,
    left: float,
    place: Callable[[float], float],
    values: Sequence[float],
    name: str,
    kind: str,
    lower: int = -6,
) -> None:
    points = [(_across(left, drones), place(value)) for drones, value in zip(_STEPS, values, strict=True)]
    for start, end in pairwise(points):
        drawing.line(start, end)
    drawing.text(points[-1][0] - 4, points[-1][1] + lower, name, f"{kind} halo", "end")
