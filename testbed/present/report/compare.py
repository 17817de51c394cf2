"""Compares two results: the conditions in which they differ, and by how much their numbers do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ...fly.results import Series
from ...numbers import kinds, quantities, words
from ...numbers.observed import observe
from ...numbers.quantities import DELAY, MISSION, PACKETS, SIZE
from ...numbers.quantity import QuantityFigure, quotient
from ...numbers.written import Metrics
from ...plan import wording
from ...plan.factors import FACTORS
from . import comparison, factors, message_set

OVERRIDES = ("AUTOPILOT", "ROUTER")
_SAME = 0.005


@dataclass(frozen=True)
class ComparedSeries:
    """A series with its metrics and the manifests of its attempts; `name` is A or B."""

    name: str
    series: Series
    metrics: Metrics
    manifests: tuple[dict[str, Any], ...]


def result_of(name: str, series: Series, metrics: Metrics) -> ComparedSeries:
    """Read the manifests of a series, as far as they can be read."""
    return ComparedSeries(name, series, metrics, tuple(attempt.manifest() for attempt in series.readable()))


@dataclass(frozen=True)
class Condition:
    """A condition of both results: its name, and its value in each."""

    name: str
    first: str
    second: str
    shapes: bool
    """Whether it is meant to affect the numbers; a kernel or a version only may."""

    @property
    def differs(self) -> bool:
        return self.first != self.second


@dataclass(frozen=True)
class ComparedMetric:
    """A metric of one protocol in both results; `change` is the second over the first, None if not defined."""

    name: str
    protocol: str
    first: QuantityFigure
    second: QuantityFigure

    @property
    def change(self) -> float | None:
        scaled = self.first.points and self.first.loss is None
        return quotient(self.second.value, self.first.value) if scaled else None


def conditions(first: ComparedSeries, second: ComparedSeries) -> list[Condition]:
    """The conditions of both results, first those that are meant to affect the numbers."""
    both = (first, second)

    def told(name: str, value: Callable[[ComparedSeries], str], shapes: bool = True) -> Condition:
        return Condition(name, value(first), value(second), shapes)

    def configured(name: str) -> Callable[[ComparedSeries], str]:
        return lambda one: _each(str(manifest["configuration"].get(name, "")) for manifest in one.manifests)

    versions = sorted({name for one in both for manifest in one.manifests for name in manifest["versions"]})
    return [
        *(told(name, _of_series(name)) for name in _SERIES),
        told("fleet", _fleet),
        *(told(name, configured(name)) for name in (*FACTORS, *OVERRIDES)),
        *([told("count", configured("count"))] if message_set.is_message_set(first.metrics) else []),
        told("revision", _revision),
        told("attempts", _attempts, shapes=False),
        told("host", _host, shapes=False),
        *(told(name, _version(name), shapes=False) for name in versions),
    ]


_SERIES = ("experiment", "arm", "profile", "shaper")


def rows(first: ComparedSeries, second: ComparedSeries) -> list[ComparedMetric]:
    """Every compared metric, protocol by protocol; a protocol that only one result has is left out."""
    tables = [{row.name: row for row in _table(one.metrics)} for one in (first, second)]
    protocols = [p for p, _ in words.sides(first.metrics) if p in second.metrics["protocols"]]
    return [
        ComparedMetric(name, protocol, row.cells[protocol], tables[1][name].cells[protocol])
        for protocol in protocols
        for name, row in tables[0].items()
        if name in tables[1] and protocol in row.cells and protocol in tables[1][name].cells
    ]


def _table(metrics: Metrics) -> list[quantities.QuantityRow]:
    if message_set.is_message_set(metrics):
        return kinds.compared(observe(metrics["protocols"]))
    return list(comparison.rows(metrics).values())


def sentences(first: ComparedSeries, second: ComparedSeries) -> list[str]:
    """Sentences on the conditions in which they differ, by how much, and whether the cause can be told."""
    differing = [c for c in conditions(first, second) if c.differs and c.shapes]
    if not differing:
        said = ["Both were flown in the same way: what differs is chance, or the machine."]
    else:
        said = [f"They differ in {wording.listed([c.name for c in differing])}."]
    by_protocol: dict[str, list[str]] = {}
    for row in rows(first, second):
        if row.name in _TOLD and row.change is not None:
            by_protocol.setdefault(row.protocol, []).append(f"{row.name} {change(row.change)}")
    said += [f"From A to B over {wording.name_of(p)}: {wording.listed(parts)}." for p, parts in by_protocol.items()]
    only = [p for one, other in ((first, second), (second, first)) for p in _missing(one, other)]
    if only:
        said.append(f"Only one of them flew {wording.listed([wording.name_of(p) for p in only])}.")
    if any(c.name == "experiment" for c in differing):
        said.append("These are different experiments, so their totals do not compare.")
    causes = {c.name for c in differing} - {"arm"}
    if len(causes) > 1:
        said.append("More than one thing differs, so these two alone do not show what made the numbers differ.")
    return said


_TOLD = (
    *(quantity.name for quantity in (PACKETS, SIZE, MISSION, DELAY)),
    *(f"mean {form}: {what}" for form in ("command", "state") for what in ("packets", "delay")),
)


def change(ratio: float) -> str:
    """'the same', '+12 %', '−34 %', '×3.4'."""
    if abs(ratio - 1) < _SAME:
        return "the same"
    if ratio >= 2:
        return f"×{words.ratio(ratio)}"
    percent = abs(100 * (ratio - 1))
    digits = 0 if 1 <= percent < 99 else 1
    return f"{'+' if ratio > 1 else '−'}{percent:.{digits}f} %"


def title(one: ComparedSeries) -> str:
    """A result in a few words: 'scenario 1, arm thesis, profile ideal', with the fleet if it is not the thesis's."""
    metrics, configuration = one.metrics, one.manifests[0]["configuration"]
    changed = [f"{name} {value}" for name, value in factors.deviations(configuration, metrics["arm"])]
    arm = f"arm {metrics['arm']}{f' with {wording.listed(changed)}' if changed else ''}"
    fleet = f", {wording.fleet(configuration['fogs'], configuration['drones'])}" if "fogs" in configuration else ""
    return f"{wording.short_name(metrics['experiment'])}, {arm}, profile {metrics['profile']}{fleet}"


def _missing(one: ComparedSeries, other: ComparedSeries) -> list[str]:
    return [protocol for protocol in one.metrics["protocols"] if protocol not in other.metrics["protocols"]]


def _of_series(name: str) -> Callable[[ComparedSeries], str]:
    def told(one: ComparedSeries) -> str:
        facts: Mapping[str, object] = one.metrics
        return str(facts[name])

    return told


def _fleet(one: ComparedSeries) -> str:
    """'five drones on three fogs (3, 1, 1)'."""
    said = []
    for manifest in one.manifests:
        behind = Counter(link["upper"] for link in manifest["topology"]["links"] if link["name"].startswith("air:"))
        each = ", ".join(str(count) for count in behind.values())
        said.append(f"{wording.fleet(len(behind), behind.total())} ({each})")
    return _each(said)


def _revision(one: ComparedSeries) -> str:
    said = []
    for manifest in one.manifests:
        commit = str(manifest["revision"].get("commit") or "not in a repository")[:12]
        said.append(f"{commit}{' with changes' if manifest['revision'].get('dirty') else ''}")
    return _each(said)


def _attempts(one: ComparedSeries) -> str:
    done = comparison.completion(one.metrics)
    return ", ".join(f"{c.completed} of {c.flown} over {wording.name_of(p)}" for p, c in done.items())


def _host(one: ComparedSeries) -> str:
    hosts = [manifest["host"] for manifest in one.manifests]
    names = [f"{host['name']}, " if "name" in host else "" for host in hosts]
    return _each(
        f"{name}{host.get('cores')} cores, Linux {host.get('kernel', '?')}"
        for name, host in zip(names, hosts, strict=True)
    )


def _version(name: str) -> Callable[[ComparedSeries], str]:
    return lambda one: _each(str(found) for manifest in one.manifests if (found := manifest["versions"].get(name)))


def _each(values: Iterable[str]) -> str:
    """Every distinct value; several are listed together, which shows that the attempts are mixed."""
    return wording.listed(sorted(set(values)))
