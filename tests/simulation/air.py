"""A fog whose drones connect by datagrams: the real state machines of both ends, with a lossy network between them."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any

from mqttxt.activator.drones import FOG
from mqttxt.core.effects import Inbound, Publish, Subscribe, Unsubscribe, Will
from mqttxt.core.mqtt.sn.air_client import AirClient
from mqttxt.core.mqtt.sn.client import SnClient
from mqttxt.core.mqtt.sn.gateway import AirGateway
from mqttxt.core.mqtt.sn.packets import CONGESTION
from mqttxt.core.mqtt.sn.together import AirMessage
from mqttxt.core.mqtt.sn.topic_ids import TopicIds
from tests.simulation.adversary import Dangers, Simulation
from tests.simulation.drone_node import DroneNode
from tests.simulation.nodes import MS, S
from tests.simulation.true_time import Broker, Channel, Client, Connection, Weather

if TYPE_CHECKING:
    from mqttxt.core.mqtt.sn.gateway import Address

Port = tuple[str, int]
MACHINE = Weather.__dataclass_fields__["latency_us"].default
"""Latencies between two programs of one machine."""


@dataclass
class Air:
    """The fate of datagrams in both directions; probabilities are per datagram."""

    loses: float = 0.1
    repeats: float = 0.05
    reorders: float = 0.05
    latency_us: tuple[int, int] = (10 * MS, 40 * MS)
    worst_delay_us: int = 3 * S
    carried: int = 0
    lost: int = 0


class Alarm:
    """Calls a state machine when it is due and its process is not stalled."""

    def __init__(
        self, sim: AirSimulation, due_s: Callable[[], float], tick: Callable[[], None], stands_us: Callable[[], int]
    ) -> None:
        self._sim, self._due_s, self._tick, self._stands_us = sim, due_s, tick, stands_us
        self._set = 0

    def arm(self) -> None:
        self._set += 1
        due_s = self._due_s()
        if due_s < inf:
            self._sim.events.at(max(int(due_s * S) + 1, self._stands_us()), self._rings, self._set)

    def _rings(self, which: int) -> None:
        if which == self._set:
            if self._sim.events.now_us >= self._stands_us():
                self._tick()
            self.arm()


@dataclass(eq=False)
class AirLink:
    """A drone's connection with the interface of `Connection`; `up` and `down` exist only to be stalled."""

    sim: AirSimulation
    node: AirDroneNode
    will: Will
    up: Channel = field(init=False)
    down: Channel = field(init=False)
    link: str = FOG

    def __post_init__(self) -> None:
        self.up, self.down = (Channel(self.sim.events, self.sim.machine) for _ in range(2))
        self.port = self.sim.port(self.node.name)
        self.machine = SnClient(self.node.client_id, self.will, TopicIds(), self._send, self)
        self.is_closed = False
        self.alarm = Alarm(self.sim, self._due_s, self._tick, lambda: self.node.stalled_until_us)
        self.sim.ports[self.port] = self.receive
        self.machine.connect(self.sim.now_s)
        self.alarm.arm()

    def publish(self, publish: Publish, read_us: int) -> None:
        self.sim.read_us[publish.topic, publish.payload] = read_us
        done = None if publish.ref is None else partial(self.node.published, FOG, publish.ref)
        self._do(lambda: self.machine.publish(publish, self.sim.now_s, done))

    def subscribe(self, subscribe: Subscribe) -> None:
        def done(codes: list[int]) -> None:
            assert not any(codes)
            self.node.subscribed(FOG, subscribe)

        self._do(lambda: self.machine.subscribe(subscribe, self.sim.now_s, done))

    def unsubscribe(self, unsubscribe: Unsubscribe) -> None:
        self._do(lambda: self.machine.unsubscribe(unsubscribe.filters, self.sim.now_s))

    def close(self) -> None:
        """Close without a DISCONNECT: the process, or its network, is gone."""
        self.is_closed = True
        self.sim.ports.pop(self.port, None)

    def receive(self, datagram: bytes) -> None:
        """Receive a datagram; a stalled process reads it when it continues."""
        wait_us = max(self.node.stalled_until_us, self.down.stalled_until_us)
        if self.sim.events.now_us < wait_us:
            self.sim.events.at(wait_us, self.receive, datagram)
        else:
            self._do(lambda: self.machine.received(datagram, self.sim.now_s))

    def on_connack(self, code: int) -> None:
        self.node.on_connack(self, code)

    def on_message(self, message: Inbound) -> None:
        self.node.received(FOG, message, self.sim.events.now_us)

    def on_ended(self) -> None:
        self.node.on_air_lost(self)

    def count(self, kind: str, detail: str) -> None:
        self.sim.counted.append((kind, detail))

    def _tick(self) -> None:
        self._do(lambda: self.machine.tick(self.sim.now_s))

    def _due_s(self) -> float:
        return inf if self.is_closed else self.machine.due_s()

    def _do(self, act: Callable[[], None]) -> None:
        if not self.is_closed:
            act()
            self.alarm.arm()

    def _send(self, datagram: bytes) -> None:
        delay_us = max(0, self.up.stalled_until_us - self.sim.events.now_us)
        self.sim.carry(delay_us, lambda: self.sim.gateway_hears(datagram, self.port))


class AirDroneNode(DroneNode):
    """A UAV client that is connected by datagrams."""

    @property
    def client_id(self) -> str:
        return f"{self.name}-{self.clock.session:08x}"

    def connect(self, link: str) -> None:
        """Begin to connect; the role is told at the CONNACK."""
        if link not in self.links:
            self._opening = AirLink(self.sim, self, self.role.will())  # type: ignore[arg-type]
            self._soon(5 * S, self._give_up, self._opening)

    def on_connack(self, link: AirLink, code: int) -> None:
        if link is self._opening and code == 0:
            self.links[FOG] = link  # type: ignore[assignment]
            self.react(self.role.on_connected, FOG)
        elif link is self._opening:
            self._give_up(link)

    def on_air_lost(self, link: AirLink) -> None:
        link.close()
        if self.links.get(FOG) is link:  # type: ignore[comparison-overlap]
            del self.links[FOG]
            self._disconnected(FOG)
        elif link is self._opening:
            self._soon(300 * MS, self.connect, FOG)

    def _give_up(self, link: AirLink) -> None:
        if self.links.get(FOG) is not link and link is self._opening and not link.is_closed:  # type: ignore[comparison-overlap]
            self.on_air_lost(link)

    def _drop(self, link: str, noticed_us: int) -> None:
        self.links.pop(link).close()  # type: ignore[attr-defined]

    def kill(self) -> None:
        self._opening.close()
        super().kill()


class _ToBroker(Client):
    """A client's side towards the simulated broker."""

    def __init__(self, sim: AirSimulation, client: Callable[[], AirClient]) -> None:
        self.sim, self._client = sim, client
        self.connection: Connection | None = None

    def open(self, client_id: str, will: Will | None) -> None:
        self.sim.events.after(2 * MS, self._open, will)

    def publish(self, told: AirMessage, ref: Hashable) -> None:
        read_us = self.sim.read_us.get((told.topic, told.payload), self.sim.events.now_us)
        if self.connection is not None:
            self.connection.publish(Publish(FOG, told.topic, told.payload, told.qos, told.retain, ref=ref), read_us)

    def subscribe(self, topic: str, live_only: bool, ref: Hashable) -> None:
        if self.connection is not None:
            self.connection.subscribe(Subscribe(FOG, (topic,), live_only, ref))

    def unsubscribe(self, topic: str) -> None:
        if self.connection is not None:
            self.connection.unsubscribe(Unsubscribe(FOG, (topic,)))

    def close(self, *, with_will: bool) -> None:
        connection, self.connection = self.connection, None
        if connection is not None:
            connection.open = False
            connection.will = connection.will if with_will else None
            connection.broker.lose(connection)

    def _open(self, will: Will | None) -> None:
        broker, client = self.sim.brokers[FOG], self._client()
        if broker.alive and client.is_there:
            up, down = (Channel(self.sim.events, self.sim.machine) for _ in range(2))
            self.connection = Connection(broker, self, FOG, will, up, down)
            broker.connect(self.connection)
        client.on_opened(0 if self.connection is not None else CONGESTION, self.sim.now_s)
        self.sim.alarm.arm()

    # Calls from the broker; on that side it is the activator's process that is stalled.

    def received(self, link: str, message: Inbound, read_us: int) -> None:
        self._client().on_message(message, self.sim.now_s)
        self.sim.alarm.arm()

    def subscribed(self, link: str, subscribe: Subscribe) -> None:
        self._client().on_subscribed(subscribe.ref)

    def published(self, link: str, ref: Any, code: int) -> None:
        self._client().on_published(ref, code)

    def broker_died(self) -> None:
        self.connection = None
        self._client().on_ended(self.sim.now_s)


class AirSimulation(Simulation):
    """`Simulation` with its drones on the air leg."""

    def __init__(self, seed: int, dangers: Dangers | None = None, qos: int = 1, air: Air | None = None) -> None:
        self.air = air or Air()
        self.ports: dict[Port, Callable[[bytes], None]] = {}
        self.read_us: dict[tuple[str, bytes], int] = {}
        self.counted: list[tuple[str, str]] = []
        self.spied: list[tuple[bytes, Port]] = []
        self._ports = 0
        super().__init__(seed, dangers, qos)

    def make_broker(self) -> Broker:
        """Make the activator's state machines along with the brokers, before the drones."""
        self.machine = Weather(self.rng)
        self.gateway = AirGateway(TopicIds(), self._to_drone, lambda client: _ToBroker(self, client), self._count)
        self.alarm = Alarm(
            *(self, lambda: self.gateway.due_s(), lambda: self.gateway.tick(self.now_s)),
            lambda: self.activator.stalled_until_us,
        )
        return super().make_broker()

    def make_drone(self, number: int) -> DroneNode:
        return AirDroneNode(self, number)

    @property
    def now_s(self) -> float:
        return self.events.now_us / S

    def port(self, name: str) -> Port:
        """A sender's address that was not used before."""
        self._ports += 1
        return name, self._ports

    def carry(self, delay_us: int, arrive: Callable[[], None]) -> None:
        """Send a datagram on its way: it may be lost, repeated or delayed."""
        air, rng = self.air, self.rng
        air.carried += 1
        if rng.random() < air.loses:
            air.lost += 1
            return
        times = 1 + (rng.random() < air.repeats)
        for _ in range(times):
            is_late = rng.random() < air.reorders
            way_us = rng.randint(0, air.worst_delay_us) if is_late else rng.randint(*air.latency_us)
            self.events.after(delay_us + way_us, arrive)

    def gateway_hears(self, datagram: bytes, port: Port) -> None:
        wait_us = self.activator.stalled_until_us
        if self.events.now_us < wait_us:
            self.events.at(wait_us, self.gateway_hears, datagram, port)
            return
        self.spied.append((datagram, port))
        self.gateway.received(datagram, port, self.now_s)
        self.alarm.arm()

    def _to_drone(self, datagram: bytes, address: Address) -> None:
        def arrive() -> None:
            hears = self.ports.get(address)
            if hears is not None:
                hears(datagram)

        self.carry(0, arrive)

    def _count(self, kind: str, detail: str) -> None:
        self.counted.append((kind, detail))

    def _kill_broker(self, broker: Broker) -> None:
        carried = [connection for connection in broker.connections if isinstance(connection.client, _ToBroker)]
        broker.connections = [connection for connection in broker.connections if connection not in carried]
        for connection in carried:
            assert isinstance(connection.client, _ToBroker)
            connection.open = False
            self.events.after(self.rng.randint(0, 1 * S), connection.client.broker_died)
        super()._kill_broker(broker)
