"""Real roles that sign, at a cloud's and a fog's broker that are hostile, over TLS on real sockets.

Each command has a place of its own, by which the autopilots' logs tell what was executed, where and when. What the
test is worth it shows by UAV clients with one rule taken away: it has to find each of them.
"""

from __future__ import annotations

import asyncio
import socket
import time
from collections import Counter
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Any

import pytest

from mqttxt import GroundStation, Outcome, Word
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.commands import Goto
from mqttxt.protocol.messages import CommandMessage
from mqttxt.security.authority import Authority
from mqttxt.security.cose import Envelope
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from tests.quick import FLYING, quick_fleet
from tests.rigs.hostile_broker import Delivery, HostileBroker
from tests.rigs.processes import Process, commanded, eventually, free_port, stand_in
from tests.rigs.salvo import MAV_CMD_DO_REPOSITION, all_reachable
from tests.simulation.broken import BROKEN

pytestmark = [pytest.mark.integration, pytest.mark.apart]

DRONES = (1, 2)
SHORT_S, LONG_S = 0.8, 5.0
"""How soon a command is due that is held back, and one that is repeated in time."""
BEHIND_S = 0.4
"""How far behind its deadline what was held back is delivered."""
FAR = 10**6
"""How far away the places are that the forger names, in 1e-7 degrees."""
SEED = 5
VIOLATIONS = {
    "verifies_nothing": "made up",
    "executes_again": "again",
    "believes_the_topic": "elsewhere",
    "believes_the_route": "late",
    "has_no_deadlines": "late",
}
"""What each of the broken UAV clients does."""


@dataclass
class Sent:
    """A command by its place: for whom, until when it may be executed, and the last words that came of it."""

    drone: int
    latest_ns: int
    last: list[Outcome] = field(default_factory=list)


def passed(topic: str, payload: bytes, **_: Any) -> list[Delivery]:
    return [(0, topic, payload)]


def dropped(topic: str, payload: bytes, **_: Any) -> list[Delivery]:
    return []


def held(topic: str, payload: bytes, **_: Any) -> list[Delivery]:
    return [(SHORT_S + BEHIND_S, topic, payload)]


def held_with_a_later_route(topic: str, payload: bytes, **_: Any) -> list[Delivery]:
    envelope = Envelope.parse(payload)
    signed_ms = decode(CommandMessage, envelope.payload).deadline_ms or 0
    return [(SHORT_S + BEHIND_S, topic, envelope.routed(signed_ms + 20_000).encode())]


def repeated(topic: str, payload: bytes, **_: Any) -> list[Delivery]:
    return [(delay_s, topic, payload) for delay_s in (0, 0, 0.05, 1.5, 2.5, 3.5)]


def moved(topic: str, payload: bytes, **_: Any) -> list[Delivery]:
    """To the other drone, and to its own behind that."""
    other = topic.replace("drone1", "drone#").replace("drone2", "drone1").replace("drone#", "drone2")
    return [(0, other, payload), (0.2, topic, payload)]


def forged(topic: str, payload: bytes, eve: Seal) -> list[Delivery]:
    """Another place and the next numbers, under the old signature and under a station's that may only observe."""
    envelope = Envelope.parse(payload)
    command = decode(CommandMessage, envelope.payload)
    assert isinstance(command.command, Goto)
    away = replace(command.command, latitude_deg=command.command.latitude_deg + FAR / 1e7)
    said = [(0.0, topic, payload)]
    for number in (1, 2):
        other = encode(replace(command, seq=command.seq + number, command=away))
        said.append((0.1, topic, replace(envelope, payload=other).encode()))
        said.append((0.1, topic, eve.sign(topic, other, with_certificate=True).encode()))
    return said


LATE = (held, held_with_a_later_route)
ATTACKS: tuple[Callable[..., list[Delivery]], ...] = (passed, dropped, *LATE, repeated, moved, forged)


class HostileSystem:
    """Two drones, their activator and a station, whose brokers are in this process."""

    def __init__(self, folder: Path, variant: str) -> None:
        self.folder = folder
        self.acme = acme = Authority.create(folder / "acme", "acme")
        for name in ("broker-cloud", "broker-fog1", "fog1", *(f"drone{drone}" for drone in DRONES)):
            acme.issue(name)
        acme.issue("gs-ops", Rights(None, take_over=True, observe=True))
        acme.issue("gs-eve", Rights(observe=True))
        self.eve = Seal(Identity.load(acme.folder / "gs-eve"))
        self.cloud = HostileBroker(acme.folder / "broker-cloud", SEED)
        self.fog = HostileBroker(acme.folder / "broker-fog1", SEED + 1)
        self.sent: dict[int, Sent] = {}
        self._variant = variant
        self._processes: list[Process] = []

    def start(self) -> None:
        """The processes, once the brokers listen."""
        fleet, ports = quick_fleet(self.folder, FLYING), {}
        for drone in DRONES:
            ports[drone] = free_port(socket.SOCK_DGRAM)
            self._processes.append(stand_in(self.folder, drone, ports[drone], fleet=fleet).start())
        activator = ["activator", "--fog", "1", "--cloud", self._url(self.cloud), "--fog-broker", self._url(self.fog)]
        self._add("activator", "mqttxt", *activator, "--drones", "1,2", "--signed", *self._identity("fog1"))
        for drone in DRONES:
            uav = ["uav", "--drone", str(drone), "--fog", "1", "--broker", self._url(self.fog), "--signed"]
            uav += ["--autopilot", f"udp:127.0.0.1:{ports[drone]}", "--journal", str(self.folder / f"journal{drone}")]
            uav += self._identity(f"drone{drone}")
            self._add(f"uav{drone}", "tests.simulation.broken", self._variant, *uav)

    async def ready(self) -> None:
        def all_ready() -> bool:
            for process in self._processes:
                assert process.exit_code is None, f"{process.name}: {process.log.read_text()[-2000:]}"
            return all(process.ready_file.exists() for process in self._processes)

        await eventually(all_ready, "all processes are ready")

    def station(self) -> GroundStation:
        return GroundStation(self._url(self.cloud), identity=self.acme.folder / "gs-ops", signed=True)

    def close(self) -> None:
        for process in self._processes:
            process.kill()

    async def attack(self, drone: Any, attack: Callable[..., list[Delivery]], x: int, y: float) -> None:
        """Send a command on which the fog's broker does this, and wait for its last word and for what comes late."""
        topic = f"drone{drone.number}/commands"
        self.fog.attacks[topic] = lambda said_on, payload: self._made(attack, said_on, payload)
        ttl_s, limit_s = (SHORT_S, 1) if attack in (*LATE, dropped) else (LONG_S, 3)
        self.sent[x] = sent = Sent(drone.number, 0)
        said = drone.goto(x / 1e7, y, 5, ttl_s=ttl_s, limit_s=limit_s)
        sent.latest_ns = time.time_ns() + round(ttl_s * 1e9)
        async for outcome in said:
            sent.last += [outcome] if outcome.is_last else []
        if attack in (*LATE, repeated):
            until_ns = sent.latest_ns + round(2e9 * BEHIND_S) if attack in LATE else sent.latest_ns
            await eventually(lambda: time.time_ns() > until_ns, "what the broker delivers later has come")

    def _made(self, attack: Callable[..., list[Delivery]], topic: str, payload: bytes) -> list[Delivery]:
        return attack(topic, payload, eve=self.eve)

    def violations(self) -> Counter[str]:
        """What the autopilots did that no station has sent them so, and words that are wrong, by kind."""
        found: Counter[str] = Counter()
        executed: Counter[tuple[int, int]] = Counter()
        for drone in DRONES:
            for event in commanded(self.folder / f"sitl{drone}.jsonl", MAV_CMD_DO_REPOSITION):
                x = event["params"][4]
                sent = self.sent.get(x)
                executed[drone, x] += 1
                found["made up"] += sent is None
                found["elsewhere"] += sent is not None and sent.drone != drone
                found["late"] += sent is not None and event["arrived_ns"] > sent.latest_ns
        found["again"] = sum(count > 1 for count in executed.values())
        for x, sent in self.sent.items():
            found["words"] += len(sent.last) != 1
            completed = any(outcome.word is Word.COMPLETED for outcome in sent.last)
            found["completed, not executed"] += completed and not executed[sent.drone, x]
        return +found

    def _add(self, name: str, module: str, *arguments: str) -> None:
        ready = ["--ready-file", str(self.folder / f"{name}.ready")]
        self._processes.append(Process(self.folder, name, module, *arguments, *ready).start())

    def _identity(self, name: str) -> list[str]:
        return ["--identity", str(self.acme.folder / name)]

    def _url(self, broker: HostileBroker) -> str:
        return f"mqtts://127.0.0.1:{broker.port}"


async def attacked(folder: Path, variant: str) -> HostileSystem:
    """Every attack on each drone, in an order that the seed gives."""
    system = HostileSystem(folder, variant)
    async with AsyncExitStack() as stack:
        stack.callback(system.close)
        await stack.enter_async_context(system.cloud)
        await stack.enter_async_context(system.fog)
        system.start()
        await system.ready()
        station = await stack.enter_async_context(system.station())
        (fog,) = await station.connect([1])
        await all_reachable(fog)
        await eventually(lambda: all(drone.is_controlled for drone in fog.drones), "both drones are controlled")
        await asyncio.gather(*(_fly(system, fog.drone(number)) for number in DRONES))
    return system


async def _fly(system: HostileSystem, drone: Any) -> None:
    assert (await drone.arm()).completed
    assert (await drone.takeoff(5)).completed
    place = drone.location.state
    order = Random(SEED + drone.number).sample(ATTACKS, len(ATTACKS))
    for number, attack in enumerate(order, start=1):
        x = round(place.latitude_deg * 1e7) + drone.number * 100 + number
        await system.attack(drone, attack, x, place.longitude_deg)


async def test_nothing_comes_of_what_hostile_brokers_do(tmp_path: Path) -> None:
    system = await attacked(tmp_path, "none")
    assert system.violations() == Counter()
    completed = [sent for sent in system.sent.values() if sent.last[0].word is Word.COMPLETED]
    assert len(completed) >= 2 * len(DRONES)
    assert sum(system.cloud.repeated.values()) > 20
    assert sum(system.fog.repeated.values()) > 20


@pytest.mark.soak("services/mqttxt/src/mqttxt/drone", "tests/rigs/hostile_broker.py", "tests/simulation/broken.py")
@pytest.mark.parametrize("variant", BROKEN)
async def test_a_drone_that_is_broken_is_found(tmp_path: Path, variant: str) -> None:
    assert (await attacked(tmp_path, variant)).violations()[VIOLATIONS[variant]]
