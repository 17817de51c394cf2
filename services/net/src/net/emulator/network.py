"""All links of a plan together, with the rates that some share and the events that change them. No I/O."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from operator import itemgetter

from .jitter import make_jitter
from .link import Link
from .plan import Event, Plan, Settings, changed
from .turns import Turns

_NS = 1_000_000_000
Change = tuple[int, str, Settings]
"""From a time in ns on, a link has these settings."""


class Network:
    """The links by name; `change_until` carries out the events. Times are ns since the shaping began."""

    def __init__(self, plan: Plan) -> None:
        self.seed = plan.seed
        shared: dict[str, Turns] = {}
        for name, link in plan.links.items():
            if link.shared_with is not None and name not in shared:
                shared[name] = shared[link.shared_with] = Turns()
        self.turns = list({id(turns): turns for turns in shared.values()}.values())
        self.links = {name: Link(name, link.settings, plan.seed, shared.get(name)) for name, link in plan.links.items()}
        self._changes = list(reversed(list(changes(plan))))
        for _, name, settings in self._changes:  # makes their tables now, not when they are due
            make_jitter(settings.distribution, settings.jitter_us * 1000, settings.reordering, plan.seed, name)

    @property
    def next_change_ns(self) -> int | None:
        return self._changes[-1][0] if self._changes else None

    def change_until(self, now_ns: int) -> None:
        """Carry out what is due."""
        while self._changes and self._changes[-1][0] <= now_ns:
            _, name, settings = self._changes.pop()
            self.links[name].change(settings)


def changes(plan: Plan) -> Iterator[Change]:
    """What the events do, in the order of time: where they overlap, the one that began last decides each field."""
    found: list[Change] = []
    for name, link in plan.links.items():
        own = [event for event in plan.events if event.link == name]
        bounds = [(ns, place) for place, event in enumerate(own) for ns in _bounds(event)]
        active: set[int] = set()
        for moment_ns, group in groupby(sorted(bounds), key=itemgetter(0)):
            active ^= {place for _, place in group}  # each event's first bound begins it, its second ends it
            settings = link.settings
            for place in sorted(active):
                settings = changed(settings, own[place].change)
            found.append((moment_ns, name, settings))
    yield from sorted(found, key=itemgetter(0))


def _bounds(event: Event) -> tuple[int, int]:
    begin_ns = round(event.at_s * _NS)
    return begin_ns, begin_ns + max(1, round(event.for_s * _NS))
