"""Simulated drones that have two links to their fog's broker, of which either is cut again and again."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from mqttxt.activator.drones import FOG
from mqttxt.core.effects import Inbound, Publish, Subscribe, Unsubscribe
from mqttxt.core.mqtt.two_links import TwoLinks
from mqttxt.drone.process import shared_topics
from mqttxt.drone.role import UavClient
from mqttxt.protocol.codec import decode
from mqttxt.protocol.messages import CommandId, CommandMessage
from tests.simulation.adversary import CALM, Dangers, Simulation
from tests.simulation.drone_node import DroneNode
from tests.simulation.nodes import MS, ActivatorNode, S
from tests.simulation.true_time import Channel, Connection, Weather

FIRST, SECOND = "fog-1", "fog-2"
LTE, LEO, GEO = (25 * MS, 60 * MS), (20 * MS, 110 * MS), (290 * MS, 310 * MS)
"""How long one way takes."""
TICK_US = 50 * MS
CALM_COMMANDS = replace(CALM, commands_per_s=2, selects=0, mute=0, ttls_ms=(5000,), ppm=(0,))


class _Way:
    """One link of a drone: what its connection carries, if it has one."""

    def __init__(self, node: TwoLinkDrone, link: str) -> None:
        self._node = node
        self._link = link

    @property
    def _connection(self) -> Connection | None:
        return self._node.links.get(self._link)

    def publish(self, effect: Publish) -> None:
        if self._connection is not None:
            self._connection.publish(effect, self._node.said_us)

    def subscribe(self, effect: Subscribe) -> None:
        if self._connection is not None:
            self._connection.subscribe(effect)

    def unsubscribe(self, effect: Unsubscribe) -> None:
        if self._connection is not None:
            self._connection.up.send(self._connection.unsubscribe, effect)

    def probe(self, answered: Callable[[], None]) -> None:
        connection = self._connection
        if connection is not None:
            connection.up.send(self._answer, connection, answered)

    def give_up(self, reason: str) -> None:
        self._node.give_up(self._link)

    def _answer(self, connection: Connection, answered: Callable[[], None]) -> None:
        """As the broker answers: where it is alive, and has the connection."""
        broker = connection.broker
        if self._node.sim.events.now_us < broker.stalled_until_us:
            self._node.sim.events.at(broker.stalled_until_us, self._answer, connection, answered)
        elif broker.alive and connection in broker.connections:
            connection.tell(lambda _: self._node.report(answered))


class TwoLinkDrone(DroneNode):
    """A UAV client whose one link is made of two connections, each with a weather of its own."""

    brokers = (FIRST, SECOND)
    sim: TwoLinkSimulation

    def make_role(self) -> UavClient:
        self.said_us = 0
        role = super().make_role()
        self.two = TwoLinks(
            FOG, (FIRST, SECOND), shared_topics(role.topics, self.number), _Events(self), self.clock.now_ms
        )
        self.two.ways = (_Way(self, FIRST), _Way(self, SECOND))
        self._soon(TICK_US, self._look)
        return role

    def connect(self, link: str) -> None:
        broker = self.sim.brokers[FOG]
        if not broker.alive or link in self.links:
            self._soon(300 * MS, self.connect, link)
            return
        for connection in [each for each in broker.connections if each.client is self and each.link == link]:
            broker.lose(connection)  # it has the same client id
        will = self.role.will()
        if link == SECOND:
            will = replace(will, topic=self.role.topics.second_reachable(self.number))
        up, down = (Channel(self.sim.events, self.sim.weathers[link]) for _ in range(2))
        self.links[link] = connection = Connection(broker, self, link, will, up, down)
        broker.connect(connection)
        self.report(self.two.connected, link)

    def give_up(self, link: str) -> None:
        """The client closes a connection that carries nothing: the broker hears of that later."""
        if link in self.links:
            self._drop(link, self.sim.rng.randint(0, 20 * S))
            self._soon(0, self._disconnected, link)

    def received(self, link: str, message: Inbound, read_us: int) -> None:
        self.report(self._received, link, message, read_us)

    def _received(self, link: str, message: Inbound, read_us: int) -> None:
        self.heard_us = read_us
        if message.topic.endswith(("/commands", "/both_links")):
            self.sim.watch.arrives(self.number, decode(CommandMessage, message.payload).id, self.sim.events.now_us)
        self.two.received(link, message)

    def subscribed(self, link: str, subscribe: Subscribe) -> None:
        self.report(self.two.subscribed, subscribe)

    def published(self, link: str, ref: Any, code: int) -> None:
        if ref is not None:
            self.report(self.two.published, link, ref, code)

    def report(self, act: Callable[..., None], *args: Any) -> None:
        """Once the process runs."""
        if not self.alive:
            return
        if self.sim.events.now_us < self.stalled_until_us:
            self._at(self.stalled_until_us, lambda: self.report(act, *args))
        else:
            act(*args)

    def _carry_out_one(self, output: Any, read_us: int) -> None:
        if isinstance(output, Publish):
            self.sim.judge.publishes(self, output, read_us)
            self.sim.watch.says(self.number, output, self.sim.events.now_us)
            self.said_us = read_us
            self.two.publish(output)
        elif isinstance(output, Subscribe):
            self.two.subscribe(output)
        elif isinstance(output, Unsubscribe):
            self.two.unsubscribe(output)
        else:
            super()._carry_out_one(output, read_us)

    def _disconnected(self, link: str) -> None:
        self.report(self.two.disconnected, link)
        self._soon(self.sim.rng.randint(100 * MS, 1 * S), self.connect, link)

    def _look(self) -> None:
        self.report(self.two.tick)
        self._at(max(self.stalled_until_us, self.sim.events.now_us + TICK_US), self._look)


class _Events:
    """What the role of a drone hears of its one link."""

    def __init__(self, node: TwoLinkDrone) -> None:
        self._node = node

    def connected(self, link: str) -> None:
        self._node.react(self._node.role.on_connected, link)

    def disconnected(self, link: str) -> None:
        self._node.react(self._node.role.on_disconnected, link)

    def received(self, link: str, message: Inbound) -> None:
        self._node.react(self._node.role.on_message, link, message, heard=(message, self._node.heard_us))

    def subscribed(self, subscribe: Subscribe) -> None:
        self._node.react(self._node.role.on_subscribed, subscribe)

    def published(self, link: str, ref: Any, code: int) -> None:
        self._node.react(self._node.role.on_published, link, ref, code)

    def count(self, kind: str, detail: str) -> None:
        raise AssertionError(f"{kind}: {detail}")


@dataclass
class Watch:
    """What happens on the way: `worst_ms` is how long it took at most until the activator had a state that a drone
    had published, or a newer one.
    """

    worst_ms: float = 0.0
    losses: list[str] = field(default_factory=list)
    """Drones that the activator called unreachable."""
    arrived_us: dict[tuple[int, CommandId], int] = field(default_factory=dict)
    """When the first copy of a command came to its drone."""
    _waiting: dict[tuple[int, str], list[int]] = field(default_factory=dict)

    def says(self, drone: int, publish: Publish, now_us: int) -> None:
        if "/state/" in publish.topic:
            self._waiting.setdefault((drone, publish.topic), []).append(now_us)

    def arrives(self, drone: int, command_id: CommandId, now_us: int) -> None:
        self.arrived_us.setdefault((drone, command_id), now_us)

    def hears(self, topic: str, said_us: int, now_us: int) -> None:
        key = int(topic[5]), topic
        waiting = self._waiting.get(key, [])
        there = [at_us for at_us in waiting if at_us <= said_us]
        self._waiting[key] = waiting[len(there) :]
        if there:
            self.worst_ms = max(self.worst_ms, (now_us - there[0]) / 1000)


class _WatchedActivator(ActivatorNode):
    sim: TwoLinkSimulation

    def received(self, link: str, message: Inbound, read_us: int) -> None:
        if link == FOG and "/state/" in message.topic:
            self.sim.watch.hears(message.topic, read_us, self.sim.events.now_us)
        super().received(link, message, read_us)

    def carry_out(self, outputs: Iterable[Any], read_us: int) -> None:
        super().carry_out(outputs, read_us)
        links = self.role.drones.links
        self.sim.watch.losses += [
            f"drone {number} at {self.sim.events.now_us / S:.1f} s"
            for number in self.sim.were_there
            if not links[number].announced
        ]


class TwoLinkSimulation(Simulation):
    """A fog whose drones have two links, with so much delay on each."""

    def __init__(
        self,
        seed: int,
        dangers: Dangers | None = None,
        qos: int = 1,
        latencies: tuple[tuple[int, int], tuple[int, int]] = (LTE, LEO),
    ) -> None:
        self.watch = Watch()
        self.were_there: set[int] = set()
        self.weathers: dict[str, Weather] = {}
        self._latencies = latencies
        super().__init__(seed, dangers, qos)
        self.cuts = 0

    def make_drone(self, number: int) -> TwoLinkDrone:
        for link, latency_us in zip((FIRST, SECOND), self._latencies, strict=True):
            self.weathers.setdefault(link, Weather(self.rng, latency_us))
        return TwoLinkDrone(self, number)

    def make_activator(self) -> ActivatorNode:
        return _WatchedActivator(self, "activator")

    def cut_either(self, seconds: int, every_s: int = 4) -> None:
        """One link of each drone at a time: broken, or stuck in one direction or both, for at most 2.5 s.

        Before the next one, both links are up.
        """
        self._become(CALM)
        self.events.run(self.events.now_us + 8 * S)
        self._become(CALM_COMMANDS)
        self.watch = Watch()
        self.were_there = {drone.number for drone in self.drones}
        for second in range(seconds):
            for _ in range(int(self.dangers.commands_per_s)):
                self.events.after(self.rng.randint(0, S), self.station.send)
            if second % every_s == 0:
                for drone in self.drones:
                    self.events.after(self.rng.randint(0, S), self._cut, drone)
            self.events.run(self.events.now_us + S)
        self.events.run(self.events.now_us + max(self.dangers.ttls_ms) * MS + 20 * S)
        self.judge.close()

    def _cut(self, drone: Any) -> None:
        link = self.rng.choice((FIRST, SECOND))
        connection = drone.links.get(link)
        if connection is None or len(drone.links) < 2:
            return
        self.cuts += 1
        until_us = self.events.now_us + self.rng.randint(200 * MS, 2500 * MS)
        stuck = self.rng.choice(((), (connection.up,), (connection.down,), (connection.up, connection.down)))
        if not stuck:
            drone.cut(link)
        for channel in stuck:
            channel.stalled_until_us = until_us

    def delays_ms(self) -> list[float]:
        """From the station's call to the first copy at the drone, of each command for each of its drones."""
        sent = self.judge.sent.items()
        arrived_us = self.watch.arrived_us
        return [(arrived_us[drone, key] - one.called_us) / 1000 for key, one in sent for drone in one.drones]
