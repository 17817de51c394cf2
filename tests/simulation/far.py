"""A ground station at the far end of a slow link: TCP over loss, simulated for each message at the cloud broker."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from mqttxt.activator.drones import CLOUD
from mqttxt.core.effects import Publish
from tests.simulation.flight import Flight

HEADERS_BYTES = 60
"""Ethernet, IP and TCP around a message."""
AGAIN = 2.2
"""How many one-way delays later a lost message arrives: a round trip and some."""


@dataclass(frozen=True)
class FarLink:
    """All hops of a profile from the ground station to the drone as one: its one-way delay and its loss."""

    name: str
    one_way_ms: float
    loss: float
    is_in_time: bool
    """Whether clients, which wait for 2 to 3 s, get an answer in that time where nothing is lost."""


FAR_LINKS = (
    FarLink("lte", 70, 0.004, True),
    FarLink("geo", 300, 0.0, True),
    FarLink("thesis", 550, 0.003, True),
    FarLink("geo-2s", 993, 0.05, False),
)


@dataclass
class Direction:
    """One direction of a TCP connection: messages stay in order, and a lost one arrives a round trip and some later."""

    delay_ms: float
    bits_s: float
    loss: float
    free_ms: float = 0.0
    arrived_ms: float = 0.0
    under_way: list[tuple[float, str, Publish]] = field(default_factory=list)

    def send(self, name: str, publish: Publish, now_ms: float, rng: random.Random) -> None:
        size = len(publish.payload) + len(publish.topic) + HEADERS_BYTES
        self.free_ms = max(now_ms, self.free_ms) + size * 8000 / self.bits_s
        arrives_ms = self.free_ms + self.delay_ms
        while rng.random() < self.loss:
            arrives_ms += AGAIN * self.delay_ms
        self.arrived_ms = max(self.arrived_ms, arrives_ms)
        self.under_way.append((self.arrived_ms, name, publish))

    def arrived(self, now_ms: float) -> list[tuple[str, Publish]]:
        here = [(name, publish) for at_ms, name, publish in self.under_way if at_ms <= now_ms]
        self.under_way = self.under_way[len(here) :]
        return here


class FarFlight(Flight):
    """A station behind the link `geo-2s`: a round trip of two seconds, and one message in twenty lost each way."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._rng = random.Random(7)
        self.up, self.down = Direction(993, 256e3, 0.05), Direction(993, 1e6, 0.05)
        self.is_far = False

    def route(self, name: str, publish: Publish) -> None:
        if not self.is_far or publish.link != CLOUD:
            super().route(name, publish)
        else:
            (self.up if name == "gs" else self.down).send(name, publish, self.now_ms, self._rng)

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds * 50)):
            super().fly(0.02)
            for direction in (self.up, self.down):
                for name, publish in direction.arrived(self.now_ms):
                    super().route(name, publish)
