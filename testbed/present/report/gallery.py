"""The figures of a report, in the page's order, from `metrics.json` and the files of the attempts shown in detail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...numbers import quantity, words
from ...numbers.attempt_entry import AttemptEntry, Load
from ...numbers.metrics.detail import PerLink
from ...numbers.observed import observe
from ...numbers.quantities import MISSION
from ...numbers.written import Metrics
from ...plan.topology import place_of_link
from . import details, thesis
from .comparison import completed
from .figures import readings
from .figures.attempts import MissionTime, ScenarioAmount, mission_time, scenarios
from .figures.delays import by_number, delays_of, distribution
from .figures.figure import Figure
from .figures.flights import Flights, flights
from .figures.losses import CAUSES, Lost, losses
from .figures.parts import parts
from .figures.sizes import BINS, histogram
from .figures.topology import DrawnLink, topology
from .figures.traffic import traffic

SLIPS = frozenset({("scenario-4", "mqttxt")})
"""Sizes printed in the thesis that its own tables contradict."""


@dataclass(frozen=True)
class DetailData:
    """The data for figures of a side's attempt that is shown in detail, besides its entry in `metrics.json`."""

    flights: Flights | None
    per_link: PerLink | None
    readings: readings.DetailedReadings | None = None


def figures_of(
    metrics: Metrics,
    shown: details.Shown,
    seen: dict[str, DetailData],
    links: list[tuple[str, str, str]],
    commands: list[str],
) -> dict[str, Figure]:
    """The figures by name; those for which these results have no data are left out.

    `links` are (name, lower node, upper node), `commands` the mission's in order.
    """
    done = {p: completed(side) for p, side in words.sides(metrics)}
    kinds = delays_of({p: attempts for p, attempts in done.items() if attempts}, commands)
    measured = {p: one.readings for p, one in seen.items() if one.readings is not None}
    made = [
        of_links(metrics, shown, links),
        flights([one.flights for one in seen.values() if one.flights is not None]),
        readings.values(measured),
        readings.delays(measured),
        by_number(kinds),
        distribution(kinds),
        histogram({p: _bins(attempt) for p, attempt in shown.items() if attempt["size_histogram"]}),
        traffic(
            {p: one.per_link.rates for p, one in seen.items() if one.per_link is not None},
            {p: _loads(attempt["load"]) for p, attempt in shown.items() if attempt["load"]},
            {p: one.flights.end_s for p, one in seen.items() if one.flights is not None},
        ),
        _scenarios(metrics, done),
        mission_time(*_missions(metrics)),
        *of_traffic(shown, seen),
    ]
    return {figure.name: figure for figure in made if figure is not None}


def of_links(metrics: Metrics, shown: details.Shown, links: list[tuple[str, str, str]]) -> Figure | None:
    """The figure of the links' measurements; `links` are (name, lower node, upper node)."""
    return topology(_topology(metrics, shown, links), metrics["profile"], metrics["shaper"])


def of_traffic(shown: details.Shown, seen: dict[str, DetailData]) -> list[Figure | None]:
    """The figures of losses by cause, and of bytes by layer and purpose."""
    return [
        losses(losses_of(shown, seen), all(one.per_link.since_start for one in seen.values() if one.per_link)),
        parts("layers", "Bytes by layer", _LAYERS_NOTE, [*(n for n, _ in details.LAYERS), "other"], _layers(shown)),
        parts("purposes", "Bytes by purpose", _PURPOSES_NOTE, PURPOSE_NAMES, _purposes(shown)),
    ]


_LAYERS_NOTE = (
    "Frame bytes on all links. Bars show each side's own shares; the thin line below is its size beside the other's. "
    "An acknowledgement of TCP without data counts under Ethernet, IP and TCP."
)
_PURPOSES_NOTE = (
    "Frame bytes on all links by what they are for; a frame that carries several messages is shared among them by "
    "length. The thin line below is the side's size beside the other's."
)
PURPOSE_NAMES = ("commands and results", "states", "sensors", "presence and ranking", "upkeep", "acknowledgements")
_OF_PURPOSE = {
    "command": PURPOSE_NAMES[0],
    "result": PURPOSE_NAMES[0],
    "state": PURPOSE_NAMES[1],
    "sensor": PURPOSE_NAMES[2],
    "presence": PURPOSE_NAMES[3],
    "upkeep": PURPOSE_NAMES[4],
    "acknowledgement": PURPOSE_NAMES[5],
}


def losses_of(shown: details.Shown, seen: dict[str, DetailData]) -> dict[str, dict[str, Lost]]:
    """The losses of each side's attempt in detail, in the whole run; links without frames are left out."""
    found: dict[str, dict[str, Lost]] = {}
    for protocol, attempt in shown.items():
        per = seen[protocol].per_link
        in_mission = {name: count["packets"] for name, count in attempt["links"].items()}
        entered = (per.entered if per is not None else {}) or in_mission  # if the captures are gone
        by_link: Mapping[str, Mapping[str, Any]] = attempt["losses"]["links"] if attempt["losses"] else {}
        found[protocol] = {
            name: Lost(count, {cause: n for cause in CAUSES if (n := by_link.get(name, {}).get(cause, 0))})
            for name, count in sorted(entered.items(), key=lambda item: place_of_link(item[0]))
        }
    return {protocol: links for protocol, links in found.items() if links}


def _topology(metrics: Metrics, shown: details.Shown, links: list[tuple[str, str, str]]) -> list[DrawnLink]:
    measured: dict[str, Any] = {}
    for attempt in shown.values():
        measured = {**attempt["links_measured"], **measured}
    ways = {name: details.figures_of_link(entry) for name, entry in measured.items()}
    return [
        DrawnLink(name, lower, upper, ways.get(f"{name}:up", {}), ways.get(f"{name}:down", {}))
        for name, lower, upper in sorted(links, key=lambda link: place_of_link(link[0]))
    ]


def _bins(attempt: AttemptEntry) -> tuple[int, ...]:
    counts = attempt["size_histogram"]
    return tuple(counts.get(f"{least}-{most}", 0) for least, most in BINS)


def _loads(load: Load) -> dict[str, tuple[int, ...]]:
    """L(x) of each fog, summed over its drones, and the total."""
    found = {}
    for name, one in load.items():
        found[name] = tuple(map(sum, zip(*one.values(), strict=True))) if isinstance(one, dict) else tuple(one)
    return found


def _layers(shown: details.Shown) -> dict[str, dict[str, int]]:
    return {p: details.by_layer(attempt["layers"]) for p, attempt in shown.items()}


def _purposes(shown: details.Shown) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {}
    for protocol, attempt in shown.items():
        for purpose, counted in attempt["purposes"].items():
            name = _OF_PURPOSE.get(purpose, "upkeep")
            by = found.setdefault(protocol, {})
            by[name] = by.get(name, 0) + counted["bytes"]
    return found


def _missions(
    metrics: Metrics,
) -> tuple[dict[str, list[MissionTime]], dict[str, quantity.QuantityFigure], dict[str, float]]:
    observed = observe(metrics["protocols"])
    sides = {}
    for protocol, side in words.sides(metrics):
        flown = [MissionTime(a["attempt"], a["mission_s"], a["status"], a["reason"]) for a in side["attempts"]]
        flown += [MissionTime(void["attempt"], None, "void", void["reason"]) for void in side["void"]]
        sides[protocol] = sorted(flown, key=lambda one: one.attempt)
    printed = thesis.of_scenario(metrics["experiment"]).get("mission_s", {}) if thesis.flew_alike(metrics) else {}
    figures = {protocol: MISSION.figure(side) for protocol, side in observed.items()}
    return sides, figures, {p: value for p, value in printed.items() if p in sides}


def _scenarios(metrics: Metrics, done: dict[str, list[AttemptEntry]]) -> Figure | None:
    """All scenarios of the thesis, with the attempts of this one; None for another experiment or fleet."""
    names = thesis.scenarios()
    if metrics["experiment"] not in names or not thesis.flew_alike(metrics):
        return None
    made = {}
    for field in ("packets", "size_bytes"):
        made[field] = {
            name: {
                p: ScenarioAmount(
                    tuple(a[field] for a in attempts) if name == metrics["experiment"] else (),
                    thesis.of_scenario(name)[field].get(p),
                )
                for p, attempts in done.items()
            }
            for name in names
        }
    return scenarios(made["packets"], made["size_bytes"], SLIPS)
