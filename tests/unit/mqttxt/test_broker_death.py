"""One of the two brokers dies at some instant of a command's exchange and comes back empty: one last word all the same.

Every publish that passes the broker is an instant, and each has three ways to be the last: it never arrives, it is
acknowledged and dies with the broker, or it is handed on and its acknowledgement dies.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import pytest

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.core.effects import Publish
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.messages import Word
from mqttxt.station.outcomes import Outcome
from tests.examples import first_quick
from tests.simulation.world import World, ack, heartbeat

pytestmark = pytest.mark.long

ARM = 400
ENDS = {CLOUD: ("activator", "gs"), FOG: ("activator", "uav")}
FATES = ("never arrives", "acknowledged only", "handed on only")
AT_MOST_MS = 30_000
"""How long after its broker's return a command may be without its last word."""


@dataclass
class MortalWorld(World):
    """A world in which the broker of `link` dies with the publish number `at`; `fate` is what becomes of that."""

    link: str = FOG
    at: int | None = None
    fate: str = FATES[0]
    passed: int = 0
    is_dead: bool = False
    counts: bool = False
    obeyed: int = 0
    acts: list[tuple[int, Any]] = field(default_factory=list)

    def route(self, name: str, publish: Publish) -> None:
        if publish.link != self.link or not self.counts:
            super().route(name, publish)
        elif not self.is_dead:
            self.passed += 1
            if self.passed != self.at:
                super().route(name, publish)
                return
            self.is_dead = True
            if self.fate == "handed on only":
                super().route(name, replace(publish, ref=None))
            elif self.fate == "acknowledged only" and publish.ref is not None and publish.qos > 0:
                self.run(name, getattr(self, name).on_published(publish.link, publish.ref, 0, self.now_ms))

    def live(self, milliseconds: int) -> None:
        """Let time pass, while the autopilot acknowledges what it hears and does it half a second later."""
        until = self.now_ms + milliseconds
        while self.now_ms < until:
            self.pass_time(100)
            for _ in self.wrote[self.obeyed :]:
                self.acts += [(self.now_ms + 200, ack(ARM)), (self.now_ms + 700, heartbeat(armed=True))]
            self.obeyed = len(self.wrote)
            due = [message for at_ms, message in self.acts if at_ms <= self.now_ms]
            self.acts = [(at_ms, message) for at_ms, message in self.acts if at_ms > self.now_ms]
            self.autopilot(*due)

    def lose_connections(self) -> None:
        self.subscribed = [entry for entry in self.subscribed if entry[1] != self.link]
        self.retained = {key: kept for key, kept in self.retained.items() if key[0] != self.link}
        for name in ENDS[self.link]:
            self.run(name, getattr(self, name).on_disconnected(self.link, self.now_ms))

    def connect(self, name: str) -> None:
        self.run(name, getattr(self, name).on_connected(self.link, self.now_ms))

    def last_words(self) -> list[Word]:
        return [event.word for event in self.heard if isinstance(event, Outcome) and event.is_last]


def begun(drone: int | None, **how: Any) -> MortalWorld:
    """A world in which one arm command was sent; from there on the broker's publishes count."""
    world = MortalWorld(**how)
    world.start()
    world.live(1000)
    world.counts = True
    world.send(Arm(), drone)
    return world


def instants(link: str, qos: int, drone: int | None) -> int:
    """How many publishes pass a broker that does not die, from the command to its last word."""
    world = begun(drone, link=link, qos=qos)
    while not world.last_words():
        world.live(100)
    assert world.last_words() == [Word.COMPLETED]
    return world.passed


@pytest.mark.parametrize("drone", [1, None], ids=["one drone", "broadcast"])
@pytest.mark.parametrize("qos", first_quick([1, 0]))
@pytest.mark.parametrize("link", [FOG, CLOUD])
def test_one_last_word_at_whatever_instant_a_broker_dies(link: str, qos: int, drone: int | None) -> None:
    for at, fate, away_ms, first in product(range(1, instants(link, qos, drone) + 1), FATES, (300, 8000), ENDS[link]):
        world = begun(drone, link=link, qos=qos, at=at, fate=fate)
        while not world.is_dead:
            world.live(100)
        world.lose_connections()
        world.live(away_ms)
        world.is_dead = False
        for name in sorted(ENDS[link], key=lambda name, first=first: name != first):  # type: ignore[misc]
            world.connect(name)
            world.live(200)
        back_ms = world.now_ms
        while not world.last_words() and world.now_ms < back_ms + AT_MOST_MS:
            world.live(100)
        world.live(1000)
        case = f"publish {at} {fate}, {away_ms} ms, {first} first: {world.last_words()}"
        assert len(world.last_words()) == 1, case
        assert (world.last_words() == [Word.COMPLETED]) == bool(world.wrote), case
        assert len(world.wrote) <= 1, case
