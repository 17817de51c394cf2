"""A whole fog in true time, and an adversary against it: the roles are the real ones, everything else is simulated.

Each process has a clock of its own within rho of true time. Processes, brokers and connections are stalled, cut
and killed; messages are lost, repeated, delayed, reordered, and sent so that they arrive around their deadline.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Any

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.core.settings import Settings
from mqttxt.security.seal import Seal
from tests.simulation.drone_node import DroneNode
from tests.simulation.nodes import DRONES, MS, ActivatorNode, Node, S, StationNode
from tests.simulation.true_time import RHO_PPM, Broker, Events, Weather
from tests.simulation.verdicts import Judge


@dataclass(frozen=True)
class Dangers:
    """The means of an adversary; each probability is per message or per process."""

    latencies_us: tuple[tuple[int, int], ...] = ((0, 1000), (3 * MS, 40 * MS), (10 * MS, 600 * MS))
    loses: float = 0.05
    repeats: float = 0.1
    reorders: float = 0.02
    aims: float = 0.15
    stalls_per_s: float = 0.015
    longest_stall_us: int = 5 * S
    kills_per_s: float = 0.004
    cuts_per_s: float = 0.006
    pauses: float = 0.001
    pausing: str = ""
    dies_between: float = 0.0002
    mute: float = 0.05
    """The probability that an autopilot executes a command without an acknowledgement."""
    ppm: tuple[int, ...] = (-RHO_PPM, RHO_PPM, 0, -137, 512)
    drifts_per_s: float = 0.2
    slow_drones: bool = False
    """Whether drones' clocks are as slow, and all others as fast, as they can be: there margins are needed most."""
    ttls_ms: tuple[int, ...] = (200, 600, 600, 1500, 5000, 10_000)
    commands_per_s: float = 10
    selects: float = 0.05
    looks_before_the_write: bool = True
    shows_retained: bool = True
    """Whether the cloud broker delivers retained messages to new subscribers."""


CALM = Dangers(
    latencies_us=((100, 2000),),
    loses=0,
    repeats=0,
    reorders=0,
    aims=0,
    stalls_per_s=0,
    kills_per_s=0,
    cuts_per_s=0,
    pauses=0,
    dies_between=0,
)


class Simulation:
    """One history: `live` runs it under dangers, then in calm weather until every command must be closed."""

    def __init__(self, seed: int, dangers: Dangers | None = None, qos: int = 1, bundles: bool = False) -> None:
        self.rng = Random(seed)
        self.dangers = dangers or Dangers()
        self.settings = Settings(qos=qos, bundles=bundles)
        self.events = Events()
        self.judge = self.make_judge()
        self.weather = Weather(self.rng)
        self._rain()
        self.brokers = {name: self.make_broker() for name in (CLOUD, FOG)}
        self.brokers[CLOUD].shows_retained = self.dangers.shows_retained
        self.drones = [self.make_drone(number) for number in DRONES]
        self.activator = self.make_activator()
        self.station = self.make_station()
        self.nodes: list[Node] = [*self.drones, self.activator, self.station]

    def make_judge(self) -> Judge:
        return Judge(self.events)

    def make_broker(self) -> Broker:
        return Broker(self.events)

    def make_drone(self, number: int) -> DroneNode:
        return DroneNode(self, number)

    def make_station(self) -> StationNode:
        return StationNode(self, "station")

    def make_activator(self) -> ActivatorNode:
        return ActivatorNode(self, "activator")

    def seal(self, name: str) -> Seal | None:
        """A node's seal; None: messages are not signed."""
        return None

    def ppm(self, name: str) -> int:
        if self.dangers.slow_drones:
            return -RHO_PPM if name.startswith("drone") else RHO_PPM
        return self.rng.choice(self.dangers.ppm)

    def live(self, seconds: int, befalls: dict[int, Callable[[], Any]] | None = None) -> Judge:
        """Start in calm weather, send under danger, and let it end in calm weather; `befalls` at given seconds."""
        dangers = self.dangers
        self._become(CALM)
        self.events.run(self.events.now_us + 3 * S)
        self._become(dangers)
        for second in range(seconds):
            for _ in range(int(dangers.commands_per_s + self.rng.random())):
                self.events.after(self.rng.randint(0, S), self.station.send)
            self._endanger()
            (befalls or {}).get(second, lambda: None)()
            self.events.run(self.events.now_us + S)
            if second % 10 == 9:
                self._rain()
        self._become(CALM)
        self.events.run(self.events.now_us + max(dangers.ttls_ms) * MS + 20 * S)
        self.judge.close()
        return self.judge

    def _become(self, dangers: Dangers) -> None:
        self.dangers = dangers
        self._rain()

    def _rain(self) -> None:
        self.weather.latency_us = self.rng.choice(self.dangers.latencies_us)
        self.weather.loses, self.weather.repeats = self.dangers.loses, self.dangers.repeats
        self.weather.reorders = self.dangers.reorders
        self.weather.aims = lambda publish: self.judge.aim(publish, self.rng, self.dangers.aims)

    def _endanger(self) -> None:
        """Choose what befalls processes, brokers and connections in the next second."""
        rng, dangers = self.rng, self.dangers
        for node in self.nodes:
            if rng.random() < dangers.drifts_per_s:
                node.hardware.drift(self.ppm(node.name))
            self._perhaps(dangers.stalls_per_s, node.stall, rng.randint(0, dangers.longest_stall_us))
            if node.alive:
                self._perhaps(dangers.kills_per_s, self._kill, node)
            for link in list(node.links):
                self._perhaps(dangers.cuts_per_s, node.cut, link)
                for channel in (node.links[link].up, node.links[link].down):
                    if rng.random() < dangers.stalls_per_s:
                        channel.stalled_until_us = self.events.now_us + rng.randint(0, dangers.longest_stall_us)
        for broker in self.brokers.values():
            if rng.random() < dangers.stalls_per_s:
                broker.stalled_until_us = self.events.now_us + rng.randint(0, dangers.longest_stall_us)
            if broker.alive:
                self._perhaps(dangers.kills_per_s, self._kill_broker, broker)

    def _perhaps(self, chance: float, act: Callable[..., None], *args: Any) -> None:
        if self.rng.random() < chance:
            self.events.after(self.rng.randint(0, S), act, *args)

    def _kill(self, node: Node) -> None:
        if node.alive:
            node.kill()

    def _kill_broker(self, broker: Broker) -> None:
        for connection in broker.die():
            node = connection.client
            assert isinstance(node, Node)
            node.cut(connection.link)
        self.events.after(self.rng.randint(200 * MS, 2 * S), setattr, broker, "alive", True)
