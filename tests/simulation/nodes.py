"""The processes of a simulated fog: real roles on drifting clocks, stalled, paused and killed at any point.

A pause falls between reading the clock and carrying out the effects, a kill also between two effects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.activator.role import Activator
from mqttxt.core.clock import RemoteClock, SessionClock
from mqttxt.core.effects import Inbound, Publish, Reconnect, Stop, Subscribe, Unsubscribe
from mqttxt.errors import FogUnreachable
from mqttxt.protocol.commands import Arm, Disarm, Goto, Hold
from mqttxt.station.outcomes import Outcome
from mqttxt.station.role import StationRole
from tests.simulation.true_time import Channel, Client, Connection, DriftingClock
from tests.simulation.world import position

if TYPE_CHECKING:
    from tests.simulation.adversary import Simulation

MS, S = 1000, 1_000_000
TICK_US = 100 * MS
DRONES = (1, 2)
PLACES = tuple(position(5.0, 200 * step) for step in range(3))
COMMANDS = (
    Arm(),
    Disarm(),
    Hold(),
    *(Goto(place.lat / 1e7, place.lon / 1e7, 5.0) for place in PLACES),
)


class Node(Client):
    """A process: a role, its session clock, its connections. Subclasses make the role."""

    brokers: tuple[str, ...] = ()

    def __init__(self, sim: Simulation, name: str) -> None:
        self.sim = sim
        self.name = name
        self.hardware = DriftingClock(sim.events, sim.ppm(name), sim.rng.randint(0, 10**15))
        self.links: dict[str, Connection] = {}
        self.stalled_until_us = 0
        self.generation = 0
        self.alive = False
        self.read_us = 0
        self.start()

    def make_role(self) -> Any:
        raise NotImplementedError

    def start(self) -> None:
        self.generation += 1
        self.alive = True
        self.clock = SessionClock(self.hardware.read_ns, self.sim.rng.randint(1, 2**32 - 1))
        self.role = self.make_role()
        for broker in self.brokers:
            self._soon(self.sim.rng.randint(0, 300 * MS), self.connect, broker)
        self._soon(self.sim.rng.randint(0, TICK_US), self._tick)

    def kill(self) -> None:
        """Kill the process at once; the brokers notice later, and a supervisor starts it again."""
        self.alive = False
        self.generation += 1
        for link in list(self.links):
            self._drop(link, self.sim.rng.randint(0, 3 * S))
        self.sim.events.after(self.sim.rng.randint(200 * MS, 3 * S), self.start)

    def cut(self, link: str) -> None:
        """Break a connection; each side notices in its own time."""
        if link in self.links:
            self._drop(link, self.sim.rng.randint(0, 2 * S))
            self._soon(self.sim.rng.randint(0, 1 * S), self._disconnected, link)

    def connect(self, link: str) -> None:
        broker = self.sim.brokers[link]
        if not broker.alive or link in self.links:
            self._soon(300 * MS, self.connect, link)
            return
        up, down = (Channel(self.sim.events, self.sim.weather) for _ in range(2))
        self.links[link] = connection = Connection(broker, self, link, self.will(link), up, down)
        broker.connect(connection)
        self.react(self.role.on_connected, link)

    def will(self, link: str) -> Any:
        return self.role.will()

    def remote_clock(self, topic: str) -> RemoteClock | None:
        """The role's record of the clock to which a beacon's topic belongs."""
        return None

    def received(self, link: str, message: Inbound, read_us: int) -> None:
        self.react(self.role.on_message, link, message, heard=(message, read_us))

    def subscribed(self, link: str, subscribe: Subscribe) -> None:
        self.react(self.role.on_subscribed, subscribe)

    def published(self, link: str, ref: Any, code: int) -> None:
        if ref is not None:
            self.react(self.role.on_published, link, ref, code)

    def react(self, method: Callable[..., Iterable[Any]], *args: Any, heard: tuple[Inbound, int] | None = None) -> None:
        """Read the clock, let the role decide, and carry out its effects, perhaps after a pause."""
        if not self.alive:
            return
        if self.sim.events.now_us < self.stalled_until_us:
            self._at(self.stalled_until_us, lambda: self.react(method, *args, heard=heard))
            return
        self.read_us = read_us = self.sim.events.now_us
        outputs = list(method(*args, self.clock.now_ms()))
        if heard is not None and heard[0].topic.endswith("clock"):
            self.sim.judge.hears_beacon(self.remote_clock(heard[0].topic), heard[0], heard[1], self.clock.now_ms())
        if self.sim.rng.random() < self.sim.dangers.pauses and self.name.startswith(self.sim.dangers.pausing):
            self.stalled_until_us = read_us + self.sim.rng.randint(0, 2 * S)
            self._at(self.stalled_until_us, lambda: self.carry_out(outputs, read_us))
        else:
            self.carry_out(outputs, read_us)

    def carry_out(self, outputs: Iterable[Any], read_us: int) -> None:
        generation = self.generation
        for output in outputs:
            if self.sim.rng.random() < self.sim.dangers.dies_between:
                self.kill()
            if self.generation != generation:
                return
            self._carry_out_one(output, read_us)

    def _carry_out_one(self, output: Any, read_us: int) -> None:
        if isinstance(output, Publish):
            connection = self.links.get(output.link)
            self.sim.judge.publishes(self, output, read_us)
            if connection is not None:
                connection.publish(output, read_us)
        elif isinstance(output, Subscribe):
            if output.link in self.links:
                self.links[output.link].subscribe(output)
        elif isinstance(output, Unsubscribe):
            if output.link in self.links:
                self.links[output.link].unsubscribe(output)
        elif isinstance(output, Reconnect):
            self.cut(output.link)
        elif isinstance(output, Stop):
            self.kill()
        else:
            self.special(output)

    def special(self, output: Any) -> None:
        """Carry out effects and events of one kind of process; the rest are logs."""

    def stall(self, duration_us: int) -> None:
        self.stalled_until_us = max(self.stalled_until_us, self.sim.events.now_us + duration_us)

    def _tick(self) -> None:
        self.react(self.role.tick)
        self._at(max(self.stalled_until_us, self.sim.events.now_us + TICK_US), self._tick)

    def _disconnected(self, link: str) -> None:
        self.react(self.role.on_disconnected, link)
        self._soon(self.sim.rng.randint(100 * MS, 1 * S), self.connect, link)

    def _drop(self, link: str, noticed_us: int) -> None:
        connection = self.links.pop(link)
        connection.open = False
        self.sim.events.after(noticed_us, connection.broker.lose, connection)

    def _soon(self, delay_us: int, act: Callable[..., None], *args: Any) -> None:
        self._at(self.sim.events.now_us + delay_us, lambda: act(*args))

    def _at(self, when_us: int, act: Callable[[], None]) -> None:
        """Schedule an act of this process; if it is killed before, the act is dropped."""
        generation = self.generation
        self.sim.events.at(when_us, lambda: act() if self.generation == generation else None)


class StationNode(Node):
    """A ground station that sends commands without a pause."""

    brokers = (CLOUD,)

    def make_role(self) -> StationRole:
        self.sim.judge.station_starts()
        role = StationRole("g", self.clock.session, self.sim.settings, seal=self.sim.seal("gs-g"))
        self.carry_out(role.add_fogs([1]), 0)
        return role

    def send(self) -> None:
        """Send a command to one drone, to all, or to the one that the fog selects."""
        rng, sim = self.sim.rng, self.sim
        if not self.alive or sim.events.now_us < self.stalled_until_us:
            return
        drone = rng.choice((*DRONES, *DRONES, None))
        selects = rng.random() < sim.dangers.selects
        among = COMMANDS[3:] if selects else COMMANDS if drone is not None else COMMANDS[:3]
        command = rng.choice(among)
        times: dict[str, Any] = {"ttl_ms": rng.choice(sim.dangers.ttls_ms), "limit_s": rng.choice((1.0, 3.0))}
        self.read_us, now_ms = sim.events.now_us, self.clock.now_ms()
        try:
            if selects:
                command_id, outputs = self.role.commands.select(self.role.fog(1), command, now_ms, **times)
            else:
                command_id, outputs = self.role.commands.send(self.role.fog(1), drone, command, now_ms, **times)
        except FogUnreachable:
            sim.judge.unsent += 1
            return
        drones = DRONES if selects or drone is None else (drone,)
        sim.judge.calls(self, command_id, drones, times["ttl_ms"], selects)
        self.carry_out(outputs, self.read_us)

    def remote_clock(self, topic: str) -> RemoteClock | None:
        found: RemoteClock | None = self.role.fogs[1].clock
        return found

    def special(self, output: Any) -> None:
        if isinstance(output, Outcome):
            self.sim.judge.says(output)

    def published(self, link: str, ref: Any, code: int) -> None:
        """Ignored: a ground station requests no acknowledgement."""


class ActivatorNode(Node):
    brokers = (CLOUD, FOG)

    def make_role(self) -> Activator:
        return Activator(1, self.clock.session, self.sim.settings, drones=DRONES, seal=self.sim.seal("fog1"))

    def will(self, link: str) -> Any:
        return self.role.will() if link == CLOUD else None

    def remote_clock(self, topic: str) -> RemoteClock | None:
        link = self.role.drones.links.get(int(topic[5])) if topic.startswith("drone") else None
        return link.clock if link is not None else None
