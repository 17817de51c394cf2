"""All links of a plan, with the rates that some share, and their changes. No I/O.

Three things change a link: the plan's events, from the start on; a change by hand, which overrides the plan's steady
figures and hides its events while it is held; and being shut, which lets nothing through in any case.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from operator import attrgetter, itemgetter
from typing import Any

from ..link_plan import EventPlan
from .jitter import make_jitter
from .link import EmulatedLink
from .plan import Settings, ShapedPlan, changed
from .turns import Turns

_NS = 1_000_000_000


@dataclass(frozen=True)
class SettingsStep:
    """A link's settings from `at_ns` after the start on; `change` has those that events set."""

    at_ns: int
    link: str
    settings: Settings
    change: Mapping[str, Any]


class Network:
    """The links by name; after `start`, `change_until` carries out the events. Times are ns of one clock."""

    def __init__(self, plan: ShapedPlan) -> None:
        self.seed = plan.seed
        shared: dict[str, Turns] = {}
        for name, link in plan.links.items():
            if link.shared_with is not None and name not in shared:
                shared[name] = shared[link.shared_with] = Turns()
        self.turns = list({id(turns): turns for turns in shared.values()}.values())
        self.links = {name: EmulatedLink(name, link, plan.seed, shared.get(name)) for name, link in plan.links.items()}
        self._steady = plan.links
        self._planned = {name: SettingsStep(0, name, link, {}) for name, link in plan.links.items()}
        self._held: dict[str, Mapping[str, Any]] = {}
        self._shut: set[str] = set()
        self._start_ns: int | None = None
        self._steps = list(reversed(list(steps(plan))))
        for step in self._steps:  # makes their tables now, not when they are due
            jitter_us, reordering = step.settings.jitter_us, step.settings.reordering
            make_jitter(step.settings.distribution, jitter_us * 1000, reordering, plan.seed, step.link)

    def start(self, at_ns: int) -> None:
        """Start events, jitter and draws, which are the same after every start."""
        self._start_ns = at_ns
        for link in self.links.values():
            link.start(at_ns)

    @property
    def next_change_ns(self) -> int | None:
        if self._start_ns is None or not self._steps:
            return None
        return self._start_ns + self._steps[-1].at_ns

    def change_until(self, now_ns: int) -> list[SettingsStep]:
        """Carry out the events that are due; returns the steps that took effect."""
        found = []
        while (due_ns := self.next_change_ns) is not None and due_ns <= now_ns:
            step = self._steps.pop()
            self._planned[step.link] = step
            if step.link not in self._held:
                found.append(step)
                self._apply(step.link)
        return found

    def hold(self, name: str, change: Mapping[str, Any]) -> None:
        """Apply a change by hand, with checked fields, in place of the previous one."""
        self._held[name] = change
        self._apply(name)

    def let_go(self, name: str) -> SettingsStep:
        """Put a link back as planned; returns the step that is in force."""
        self._held.pop(name, None)
        self._apply(name)
        return self._planned[name]

    def shut(self, name: str, shut: bool) -> None:
        """Let nothing through, or go back to the link's other settings."""
        (self._shut.add if shut else self._shut.discard)(name)
        self._apply(name)

    def _apply(self, name: str) -> None:
        held = self._held.get(name)
        settings = self._planned[name].settings if held is None else changed(self._steady[name], held)
        self.links[name].change(replace(settings, closed=True) if name in self._shut else settings)


def steps(plan: ShapedPlan) -> Iterator[SettingsStep]:
    """The steps that the events make, sorted by time; where events overlap, the one that began last sets each field."""
    found: list[SettingsStep] = []
    for name, link in plan.links.items():
        own = [event for event in plan.events if event.link == name]
        bounds = [(ns, place) for place, event in enumerate(own) for ns in _bounds(event)]
        active: set[int] = set()
        for moment_ns, group in groupby(sorted(bounds), key=itemgetter(0)):
            active ^= {place for _, place in group}  # each event's first bound begins it, its second ends it
            change: dict[str, Any] = {}
            for place in sorted(active):
                change |= own[place].change
            found.append(SettingsStep(moment_ns, name, changed(link, change), change))
    yield from sorted(found, key=attrgetter("at_ns"))


def _bounds(event: EventPlan) -> tuple[int, int]:
    begin_ns = round(event.at_s * _NS)
    return begin_ns, begin_ns + max(1, round(event.for_s * _NS))
