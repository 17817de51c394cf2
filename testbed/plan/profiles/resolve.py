"""A profile for a topology and an attempt: every directed link with its figures, and the events in order of time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from random import Random

from net import link_plan
from net.link_plan import DIRECTIONS, EventPlan, LinkPlan

from ...errors import UserError
from ..topology import Link, Topology
from .checks import check_event, check_link
from .draws import link_seed, occurrences, plan_seed
from .reading import EventRule, Profile, ProfileEntry, ProfileFigure
from .units import show_time

LENGTH_S = 1500.0
"""The default length of a plan: the time limit of a scenario's mission."""


@dataclass(frozen=True)
class LinksPlan(link_plan.BaseLinksPlan):
    """The plan that every shaper takes. `figures` has the sources of each link's figures; it is not in the data."""

    figures: Mapping[str, Mapping[str, ProfileFigure]] = field(default_factory=dict, compare=False)


def resolve(
    profile: Profile, topology: Topology, experiment: str, attempt: int, length_s: float = LENGTH_S
) -> LinksPlan:
    """The plan of an attempt, `length_s` seconds long.

    Raises UserError that names file, field, value and what was expected, for a link that does not exist, an event after
    the end, and figures that do not fit together.
    """
    _check_names(profile, topology)
    seed = plan_seed(experiment, attempt)
    figures: dict[str, dict[str, ProfileFigure]] = {}
    links: dict[str, LinkPlan] = {}
    for link in topology.links:
        shared = _shared(profile, link)
        found = {direction: _figures_of(profile, link, direction) for direction in DIRECTIONS}
        for direction, other in zip(DIRECTIONS, reversed(DIRECTIONS), strict=True):
            name = f"{link.name}:{direction}"
            figures[name] = found[direction]
            partner = f"{link.name}:{other}" if shared is not None and shared.value else None
            links[name] = _link_plan(found[direction], partner)
            check_link(asdict(links[name]), found[direction])
        up, down = (links[f"{link.name}:{direction}"] for direction in DIRECTIONS)
        if shared is not None and shared.value and (up.rate_bps is None or up.rate_bps != down.rate_bps):
            raise UserError(f"{shared.where}: 'true': expected one rate for both directions of {link.name}")
    events = [
        event for number, rule in enumerate(profile.rules) for event in _events(rule, number, links, seed, length_s)
    ]
    order = {name: place for place, name in enumerate(links)}
    events.sort(key=lambda event: (event.at_s, order[event.link]))
    return LinksPlan(profile.name, seed, links, tuple(events), figures)


def _check_names(profile: Profile, topology: Topology) -> None:
    names = [link.name for link in topology.links]
    for layer in profile.layers:
        for name in layer.overrides:
            if name not in names:
                raise UserError(f"{layer.file}: overrides.{name}: no such link: expected one of {', '.join(names)}")
    for rule in profile.rules:
        name = _undirected(rule.link)
        if ":" in name and name not in names:
            raise UserError(f"{rule.where}.link: {rule.link!r}: no such link: expected one of {', '.join(names)}")


def _entries(profile: Profile, link: Link) -> Iterator[ProfileEntry]:
    """A link's entries, the least specific first: its class in every file, then the link itself in every file."""
    for section, name in (("classes", link.name.partition(":")[0]), ("overrides", link.name)):
        for layer in profile.layers:
            entry = getattr(layer, section).get(name)
            if entry is not None:
                yield entry


def _figures_of(profile: Profile, link: Link, direction: str) -> dict[str, ProfileFigure]:
    found: dict[str, ProfileFigure] = {}
    for entry in _entries(profile, link):
        found |= {name: figure for (way, name), figure in entry.figures.items() if way == direction}
    return found


def _shared(profile: Profile, link: Link) -> ProfileFigure | None:
    found = None
    for entry in _entries(profile, link):
        found = entry.shared or found
    return found


def _link_plan(figures: Mapping[str, ProfileFigure], partner: str | None) -> LinkPlan:
    link = replace(LinkPlan(), **{name: figure.value for name, figure in figures.items()})
    rate = figures.get("rate_bps")
    is_lifted = rate is not None and rate.value is None
    return replace(link, shared_with=partner, queue_packets=None if is_lifted else link.queue_packets)


def _events(
    rule: EventRule, number: int, links: Mapping[str, LinkPlan], seed: int, length_s: float
) -> Iterator[EventPlan]:
    length_us = round(length_s * 1_000_000)
    if rule.at_us is not None and rule.at_us >= length_us:
        text = show_time(rule.at_us)
        raise UserError(f"{rule.where}.at: {text!r}: expected a time before the end, {show_time(length_us)}")
    change = {name: figure.value for name, figure in rule.change.items()}
    if "rate_bps" in change and change["rate_bps"] is None:
        change["queue_packets"] = None
    touched = [name for name in links if f"{name}:".startswith(f"{rule.link}:") or _of_class(name, rule.link)]
    for name in touched:
        check_event(asdict(links[name]), rule, change)
    for name in touched:
        draw = Random(link_seed(seed, _undirected(name), f"event {number}"))
        for at_us, for_us in occurrences(rule, draw, length_us):
            yield EventPlan(at_us / 1_000_000, name, for_us / 1_000_000, change)


def _of_class(name: str, wanted: str) -> bool:
    """Whether `wanted` is a direction of all links of a class, as `air:up`, and `name` is one of them."""
    kind, _, direction = wanted.partition(":")
    return direction in DIRECTIONS and name.startswith(f"{kind}:") and name.endswith(f":{direction}")


def _undirected(name: str) -> str:
    for direction in DIRECTIONS:
        name = name.removesuffix(f":{direction}")
    return name
