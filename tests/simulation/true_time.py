"""True time for a simulation: events in their order, clocks that drift from it, and a network that misbehaves.

Everything is drawn from one seeded generator, so a seed is a whole history.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import Any

from mqttxt.core.effects import Inbound, Publish, Subscribe, Unsubscribe, Will
from tests.simulation.world import matches

RHO_PPM = 1000


class Events:
    """A schedule of acts, in microseconds of true time."""

    def __init__(self) -> None:
        self.now_us = 0
        self._heap: list[tuple[int, int, Callable[..., None], tuple[Any, ...]]] = []
        self._count = 0

    def at(self, when_us: int, act: Callable[..., None], *args: Any) -> None:
        """Schedule an act; acts that are due together happen in the order of scheduling."""
        self._count += 1
        heapq.heappush(self._heap, (max(when_us, self.now_us), self._count, act, args))

    def after(self, delay_us: int, act: Callable[..., None], *args: Any) -> None:
        self.at(self.now_us + delay_us, act, *args)

    def run(self, until_us: int) -> None:
        while self._heap and self._heap[0][0] <= until_us:
            self.now_us, _, act, args = heapq.heappop(self._heap)
            act(*args)
        self.now_us = until_us


class DriftingClock:
    """The clock of a machine: it keeps a rate within rho that may change at any time, and can be stepped."""

    def __init__(self, events: Events, ppm: int, start_ns: int = 0) -> None:
        self._events = events
        self._ppm = ppm
        self._from_us = events.now_us
        self._from_ns = start_ns

    def read_ns(self) -> int:
        return self._from_ns + (self._events.now_us - self._from_us) * (1_000_000 + self._ppm) // 1000

    def drift(self, ppm: int) -> None:
        self._from_ns, self._from_us = self.read_ns(), self._events.now_us
        self._ppm = ppm

    def step(self, milliseconds: int) -> None:
        self._from_ns += milliseconds * 1_000_000


@dataclass
class Weather:
    """How bad a network is. Delays are in microseconds, probabilities per message."""

    rng: Random
    latency_us: tuple[int, int] = (200, 2000)
    loses: float = 0.0
    repeats: float = 0.0
    reorders: float = 0.0
    worst_delay_us: int = 12_000_000
    aims: Callable[[Publish], int | None] = lambda publish: None
    """The instant at which a message is to arrive, None to leave it to chance."""

    def latency(self) -> int:
        return self.rng.randint(*self.latency_us)

    def delays(self, publish: Publish | None, now_us: int) -> list[tuple[int, bool]]:
        """(delay, whether in order) of each arriving copy of a message."""
        rng = self.rng
        if publish is not None and publish.qos == 0 and rng.random() < self.loses:
            return []
        found = [(self.latency(), True)]
        if publish is None:
            return found
        aim = self.aims(publish)
        if aim is not None and aim > now_us:
            found = [(aim - now_us, False)]
        elif rng.random() < self.reorders:
            found = [(rng.randint(0, self.worst_delay_us), False)]
        while rng.random() < self.repeats:
            found.append((int(self.worst_delay_us * rng.random() ** 3), False))
        return found


class Channel:
    """One direction of a connection: in order as by TCP, except for messages that the weather reorders."""

    def __init__(self, events: Events, weather: Weather) -> None:
        self._events = events
        self._weather = weather
        self._last_us = 0
        self.stalled_until_us = 0

    def send(self, arrive: Callable[..., None], *args: Any, publish: Publish | None = None) -> None:
        now_us = self._events.now_us
        for delay_us, in_order in self._weather.delays(publish, now_us):
            when_us = max(now_us, self.stalled_until_us) + delay_us
            if in_order:
                when_us = self._last_us = max(self._last_us, when_us)
            self._events.at(when_us, arrive, *args)


class Client:
    """A broker's calls to one of its clients."""

    def received(self, link: str, message: Inbound, read_us: int) -> None: ...
    def subscribed(self, link: str, subscribe: Subscribe) -> None: ...
    def published(self, link: str, ref: Any, code: int) -> None: ...


@dataclass(eq=False)
class Connection:
    """A client's connection to a broker; `filters` are (topic filter, live only)."""

    broker: Broker
    client: Client
    link: str
    will: Will | None
    up: Channel
    down: Channel
    open: bool = True
    filters: list[tuple[str, bool]] = field(default_factory=list)

    def publish(self, publish: Publish, read_us: int) -> None:
        """Send to the broker; `read_us`: when the publisher read its clock for this message."""
        self.up.send(self.broker.route, self, publish, read_us, publish=publish)

    def subscribe(self, subscribe: Subscribe) -> None:
        self.up.send(self.broker.subscribe, self, subscribe)

    def unsubscribe(self, unsubscribe: Unsubscribe) -> None:
        self.filters = [one for one in self.filters if one[0] not in unsubscribe.filters]

    def tell(self, act: Callable[..., None], *args: Any, publish: Publish | None = None) -> None:
        self.down.send(self._if_open, act, args, publish=publish)

    def _if_open(self, act: Callable[..., None], args: tuple[Any, ...]) -> None:
        if self.open:
            act(self.link, *args)


class Broker:
    """A plain MQTT broker as a process that can be stalled and killed."""

    def __init__(self, events: Events) -> None:
        self._events = events
        self.connections: list[Connection] = []
        self.retained: dict[str, tuple[Publish, int]] = {}
        self.shows_retained = True
        self.alive = True
        self.stalled_until_us = 0

    def connect(self, connection: Connection) -> None:
        self.connections.append(connection)

    def lose(self, connection: Connection) -> None:
        """Drop a connection that is gone to the broker, and publish its will."""
        if connection in self.connections:
            self.connections.remove(connection)
            will = connection.will
            if will is not None and self.alive:
                self._spread(Publish(connection.link, will.topic, will.payload, 1, retain=True), self._events.now_us)

    def die(self) -> list[Connection]:
        """End at once, without retained messages and connections; returns the connections that it had."""
        self.alive = False
        gone, self.connections = self.connections, []
        self.retained.clear()
        return gone

    def route(self, connection: Connection, publish: Publish, read_us: int) -> None:
        if self._wait(self.route, connection, publish, read_us) or connection not in self.connections:
            return
        count = self._spread(publish, read_us)
        if publish.qos > 0:
            connection.tell(connection.client.published, publish.ref, 0 if count else 0x10)

    def subscribe(self, connection: Connection, subscribe: Subscribe) -> None:
        if self._wait(self.subscribe, connection, subscribe) or connection not in self.connections:
            return
        connection.filters += [(wanted, subscribe.live_only) for wanted in subscribe.filters]
        connection.tell(connection.client.subscribed, subscribe)
        if self.shows_retained and not subscribe.live_only:
            for topic, (publish, read_us) in list(self.retained.items()):
                if any(matches(wanted, topic) for wanted in subscribe.filters):
                    message = Inbound(topic, publish.payload, publish.qos, True)
                    connection.tell(connection.client.received, message, read_us)

    def _wait(self, act: Callable[..., None], *args: Any) -> bool:
        """Whether an act cannot happen now: a stalled broker does it later, a dead one never."""
        if self._events.now_us < self.stalled_until_us:
            self._events.at(self.stalled_until_us, act, *args)
            return True
        return not self.alive

    def _spread(self, publish: Publish, read_us: int) -> int:
        if publish.retain:
            self.retained[publish.topic] = (publish, read_us)
        count = 0
        for connection in self.connections:
            found = [live for wanted, live in connection.filters if matches(wanted, publish.topic)]
            if found:
                count += 1
                message = Inbound(publish.topic, publish.payload, publish.qos, publish.retain and found[0])
                connection.tell(connection.client.received, message, read_us, publish=publish)
        return count
