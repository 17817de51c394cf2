"""One connection to a broker, made of two: which of them carries what, and when they change places.

To its role it is a link like any other (docs/protocol.md, section 19). No I/O: `pair` runs it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Protocol

from ..effects import Inbound, Publish, Subscribe, Unsubscribe
from .events import LinkEvents
from .measure import PROBE_MS, SPARE_PROBE_MS, Measure

logger = logging.getLogger("mqttxt.mqtt")

CLEARLY, AND_MS = 0.7, 50
"""The other link is better where its cost and 50 ms are below this share of the main one's."""
BETTER_FOR_MS = 5_000
LEAST_MS = 10_000
"""Between two changes that nothing but quality asks for."""
LEAST_ANSWERS = 3
GIVE_UP_MS = 5_000
PRESENCE = "presence of a link"
"""The `ref` of what a link says of itself: it is up once the broker has acknowledged that."""


class Way(Protocol):
    """One of the two links, as its connection carries things out."""

    def publish(self, effect: Publish) -> None: ...
    def subscribe(self, effect: Subscribe) -> None: ...
    def unsubscribe(self, effect: Unsubscribe) -> None: ...
    def probe(self, answered: Callable[[], None]) -> None: ...
    def give_up(self, reason: str) -> None: ...


@dataclass(frozen=True)
class Shared:
    """The topics that two links treat in a way of their own.

    `presence` are those of the first and the second link, `both` that of messages for both, which are there as if they
    had come on `alone`. Of messages on `ordered` only the main link's count. What is said on a topic in `urgent` goes
    out over both.
    """

    presence: tuple[str, str]
    both: str
    alone: str
    ordered: str
    urgent: frozenset[str]


@dataclass(frozen=True)
class _Ref:
    """Whose subscription it is: a link's own, or the role's since a change of the main link."""

    way: int
    generation: int
    of_role: Subscribe | None = None


class TwoLinks:
    """`ways` are connected and report here under their `names`; the role hears of one link, `name`, by `events`."""

    def __init__(
        self,
        name: str,
        names: tuple[str, str],
        shared: Shared,
        events: LinkEvents,
        clock: Callable[[], int],
    ) -> None:
        self.name = name
        self.ways: tuple[Way, ...] = ()
        self.main: int | None = None
        """The link that the role uses; None where neither is up."""
        self._names = names
        self._shared = shared
        self._events = events
        self._clock = clock
        self._measures: list[Measure | None] = [None, None]
        """Of the links that are up."""
        self._subacks = [0, 0]
        self._generation = 0
        self._awaited = 0
        self._takes_ordered = False
        self._leaving: tuple[int, set[str]] | None = None
        """The link that was the main one before, and the filters that it still has of that."""
        self._filters: set[str] = set()
        self._presence: Publish | None = None
        self._looked_ms: int | None = None
        self._better_ms: int | None = None
        self._changed_ms = 0

    # What the role asks of its link.

    def publish(self, effect: Publish) -> None:
        if effect.topic == self._shared.presence[0]:
            self._presence = effect
            for way in (0, 1):
                self._say_presence(way)
        elif self.main is not None:
            ways = (0, 1) if effect.topic in self._shared.urgent else (self.main,)
            for way in ways:
                if self._measures[way] is not None:
                    self.ways[way].publish(effect)

    def subscribe(self, effect: Subscribe) -> None:
        if self.main is None:
            return
        filters = tuple(topic for topic in effect.filters if topic != self._shared.presence[0])
        self._filters |= set(filters)
        self._awaited += 1
        self.ways[self.main].subscribe(replace(effect, filters=filters, ref=_Ref(self.main, self._generation, effect)))

    def unsubscribe(self, effect: Unsubscribe) -> None:
        if self.main is not None:
            self._filters -= set(effect.filters)
            self.ways[self.main].unsubscribe(effect)

    # What the two links report.

    def connected(self, link: str) -> None:
        way = self._names.index(link)
        self._measures[way] = Measure()
        self._subacks[way] = 2
        own = _Ref(way, self._generation)
        self.ways[way].subscribe(Subscribe(link, (self._shared.both,), live_only=True, ref=own))
        self.ways[way].subscribe(Subscribe(link, (self._shared.presence[way],), ref=own))
        if self.main is None:
            self._make_main(way)

    def disconnected(self, link: str) -> None:
        way = self._names.index(link)
        self._measures[way] = None
        if self._leaving is not None and self._leaving[0] == way:
            self._leaving = None
        if way != self.main:
            return
        other = 1 - way
        if self._measures[other] is not None:
            self._change("its connection has ended")
            return
        self.main = None
        self._events.disconnected(self.name)

    def received(self, link: str, message: Inbound) -> None:
        way, topic = self._names.index(link), message.topic
        if topic == self._shared.ordered and not (way == self.main and self._takes_ordered):
            return
        if topic == self._shared.both:
            message = replace(message, topic=self._shared.alone)
        elif topic == self._shared.presence[way]:
            message = replace(message, topic=self._shared.presence[0])
        self._events.received(self.name, message)

    def subscribed(self, subscribe: Subscribe) -> None:
        ref = subscribe.ref
        assert isinstance(ref, _Ref)
        if ref.of_role is None:
            self._subacks[ref.way] -= 1
            self._say_presence(ref.way)
            return
        if ref.generation != self._generation:
            return
        self._awaited -= 1
        if self._shared.ordered in subscribe.filters:
            self._takes_ordered = True
        self._events.subscribed(ref.of_role)
        if self._awaited == 0:
            self._leave()

    def published(self, link: str, ref: Hashable, code: int) -> None:
        if ref == PRESENCE:
            logger.info("%s: up", link)
        else:
            self._events.published(self.name, ref, code)

    def count(self, kind: str, detail: str) -> None:
        self._events.count(kind, detail)

    # Measuring, and changing places.

    def tick(self) -> None:
        """Ask what is due, and look at the answers; to be called at least ten times a second."""
        now_ms = self._clock()
        passed_ms = now_ms - self._looked_ms if self._looked_ms is not None else 0
        self._looked_ms = now_ms
        for measure in self._measures:
            if measure is not None:
                measure.on_time(passed_ms)
        for way in (0, 1):
            self._ask(way, now_ms)
        if self.main is None:
            return
        main, other = self._measures[self.main], self._measures[1 - self.main]
        if main is None or other is None:
            self._better_ms = None
            return
        for way, measure, beside in ((self.main, main, other), (1 - self.main, other, main)):
            if measure.waited_ms > GIVE_UP_MS and not beside.is_silent:
                self.ways[way].give_up("it does not answer")
        if main.is_silent and not other.is_silent:
            self._change(f"silent for {main.waited_ms} ms")
        elif self._is_better(main, other, now_ms):
            self._change(f"{main.cost_ms:.0f} ms by round trip and loss, the other link {other.cost_ms:.0f} ms")

    def _ask(self, way: int, now_ms: int) -> None:
        measure = self._measures[way]
        if measure is None:
            return
        main = self._measures[self.main] if self.main is not None else None
        is_wanted = way == self.main or (main is not None and main.is_doubtful)
        if measure.is_due(now_ms, PROBE_MS if is_wanted else SPARE_PROBE_MS):
            measure.on_asked(now_ms)
            self.ways[way].probe(lambda: measure.on_answer(self._clock()))

    def _is_better(self, main: Measure, other: Measure, now_ms: int) -> bool:
        """Whether the other link is, and has been for long."""
        if main.cost_ms is None or other.cost_ms is None or other.answers < LEAST_ANSWERS or other.is_silent:
            is_better = False
        else:
            is_better = other.cost_ms + AND_MS < CLEARLY * main.cost_ms
        if not is_better:
            self._better_ms = None
            return False
        if self._better_ms is None:
            self._better_ms = now_ms
        return now_ms - self._better_ms >= BETTER_FOR_MS and now_ms - self._changed_ms >= LEAST_MS

    def _change(self, reason: str) -> None:
        """The other link becomes the main one."""
        assert self.main is not None
        logger.info("%s: %s, goes on over %s", self._names[self.main], reason, self._names[1 - self.main])
        self._leave()
        if self._measures[self.main] is not None:
            self._leaving = (self.main, self._filters)
        self._make_main(1 - self.main)

    def _make_main(self, way: int) -> None:
        """From here on the role's link is this one: it subscribes anew, as on a new connection."""
        self.main = way
        self._generation += 1
        self._awaited, self._takes_ordered, self._filters = 0, False, set()
        self._better_ms, self._changed_ms = None, self._clock()
        self._events.connected(self.name)

    def _leave(self) -> None:
        """What the main link has now the one before need not have any longer."""
        if self._leaving is not None:
            way, filters = self._leaving
            self._leaving = None
            self.ways[way].unsubscribe(Unsubscribe(self._names[way], tuple(sorted(filters))))

    def _say_presence(self, way: int) -> None:
        """A link's presence is said over itself, once it hears what is for both."""
        if self._presence is not None and self._measures[way] is not None and self._subacks[way] == 0:
            self.ways[way].publish(replace(self._presence, topic=self._shared.presence[way], ref=PRESENCE))
