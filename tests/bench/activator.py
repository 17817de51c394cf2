"""States that an activator, and Mosquitto's own bridge, relay per CPU second from fog to cloud; its load and memory."""

from __future__ import annotations

import asyncio
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from mqttxt.protocol.bundles import FogBundle, states_of
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import Registration
from mqttxt.protocol.messages import FogPresence
from mqttxt.security.authority import Authority
from mqttxt.security.identity import Identity
from mqttxt.security.rights import Rights
from mqttxt.security.seal import Seal
from testbed.numbers.packets.signed import inside
from tests.bench.brokers import BenchBroker, TwoWayBroker, cpu_s, rss_mb
from tests.bench.fleet import FIVE, Fleet
from tests.bench.raw_mqtt import RawClient
from tests.rigs.processes import Program, eventually

DRONES_A_FOG = 250
"""As many as there are MAVLink system ids."""
BUSY_HZ, FULL_HZ, VITAL_HZ = 25.0, 5.0, 1.0
"""How often each of five states is sent."""
WARM_UP_S, WINDOW_S, SLICE_S = 1.0, 6.0, 0.02
QUIET_S = 2.2
"""Longer than bundles wait."""
_BRIDGE = """
connection cloud
address 127.0.0.1:{port}
bridge_protocol_version mqttv50
notifications false
topic +/state/# out 0 f1/ fog1/
"""


@dataclass(frozen=True)
class Relayed:
    """The states relayed in a window, and their cost to the processes that relayed them."""

    states: int
    lost: int
    wall_s: float
    cpu_s: float
    rss_mb: float

    @property
    def per_cpu_s(self) -> float:
        return self.states / self.cpu_s

    @property
    def share(self) -> float:
        """The share of one core."""
        return self.cpu_s / self.wall_s


def measure() -> list[str]:
    """Lines of figures; takes about three minutes."""
    return asyncio.run(_measure())


async def _measure() -> list[str]:
    loads = [
        (await relay_by_activators(1, DRONES_A_FOG, hz), await relay_by_bridge(DRONES_A_FOG, hz))
        for hz in (FULL_HZ, BUSY_HZ)
    ]
    few = await relay_by_activators(1, 10, VITAL_HZ)
    some = await relay_by_activators(1, 100, VITAL_HZ)
    thousand = await relay_by_activators(4, DRONES_A_FOG, VITAL_HZ)
    bundled = await relay_by_activators(4, DRONES_A_FOG, VITAL_HZ, bundles=True)
    return [
        *(
            f"activator: relays {own.per_cpu_s:,.0f} states per CPU second ({own.states / own.wall_s:,.0f} per second, "
            f"{100 * own.share:.0f} % of a core, {own.lost} lost); Mosquitto's bridge doing the same "
            f"{bridge.per_cpu_s:,.0f} ({bridge.per_cpu_s / own.per_cpu_s:.1f} times)"
            for own, bridge in loads
        ),
        f"activator: 1,000 drones (four fogs of {DRONES_A_FOG}) with 5 states a second take "
        f"{100 * thousand.share:.0f} % of a core together ({thousand.lost} lost), "
        f"{100 * bundled.share:.0f} % in bundles ({bundled.lost} states superseded by newer ones in them)",
        f"activator: at that load {thousand.per_cpu_s:,.0f} states per CPU second, {bundled.per_cpu_s:,.0f} in bundles",
        f"activator: resident memory with 10, 100 and 1,000 drones {few.rss_mb:.0f}, {some.rss_mb:.0f} and "
        f"{thousand.rss_mb:.0f} MB (the last: four processes together)",
    ]


async def relay_secured(drones: int, hz: float, security: str) -> Relayed:
    """As `relay_by_activators` at one activator, whose own connections are in TLS; `signed`: all nodes sign.

    The brokers have plain listeners, too, for the drones and the station, so that nothing else changes.
    """
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        authority = Authority.create(folder / "acme", "acme")
        cloud, fog = (TwoWayBroker(folder, place, authority.issue(f"broker-{place}")) for place in ("cloud", "fog1"))
        for broker in (cloud, fog):
            stack.callback(broker.start().kill)
        is_signed = security == "signed"
        identity = ["--identity", str(authority.issue("fog1")), *(["--signed"] if is_signed else [])]
        brokers = ["--cloud", cloud.tls_url, "--fog-broker", fog.tls_url, "--fog-root", "f1/"]
        numbers = range(1, drones + 1)
        seals = {number: seal_of(authority.issue(f"drone{number}")) for number in (numbers if is_signed else ())}
        station = await _Station.at(cloud, stack)
        pid = await _activator(folder, stack, 1, *brokers, *identity)
        rights = Rights(None, take_over=True, observe=True)
        await station.register(seal_of(authority.issue("gs-bench", rights)) if is_signed else None)
        return await _relayed([Fleet(fog.port, numbers, "f1/", seals=seals)], station, hz, [pid])


async def relay_by_activators(fogs: int, drones: int, hz: float, bundles: bool = False) -> Relayed:
    """Relay five states of each of `drones` drones at each of `fogs` activators, each `hz` times per second."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        cloud, fog = _started(folder, stack, "cloud"), _started(folder, stack, "fog")
        station = await _Station.at(cloud, stack)
        pids, fleets = [], []
        for number in range(1, fogs + 1):
            options = ["--cloud", cloud.url, "--fog-broker", fog.url, "--fog-root", f"f{number}/"]
            pids.append(await _activator(folder, stack, number, *options))
            await station.register(None, number, bundles)
            fleets.append(Fleet(fog.port, range(1, drones + 1), f"f{number}/", bundles))
        return await _relayed(fleets, station, hz, pids)


async def relay_by_bridge(drones: int, hz: float) -> Relayed:
    """Relay the same by a fog broker that bridges to the cloud broker."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        cloud = _started(folder, stack, "cloud")
        fog = _started(folder, stack, "fog", _BRIDGE.format(port=cloud.port))
        station = await _Station.at(cloud, stack)
        return await _relayed([Fleet(fog.port, range(1, drones + 1), "f1/")], station, hz, [fog.pid])


def seal_of(folder: Path) -> Seal:
    """The seal of the node whose identity is in a folder."""
    return Seal(Identity.load(folder))


async def _activator(folder: Path, stack: ExitStack, fog: int, *options: str) -> int:
    """Start a fog's activator; returns its process id once it is ready. No fork: its memory is its own."""
    ready = folder / f"activator{fog}.ready"
    command = [sys.executable, "-m", "mqttxt", "activator", "--fog", str(fog), "--ready-file", str(ready), *options]
    process = Program(folder, f"activator{fog}", *command).start()
    stack.callback(process.stop)
    await eventually(ready.exists, f"activator {fog} ready")
    return process.pid


def _started(folder: Path, stack: ExitStack, name: str, more: str = "") -> BenchBroker:
    broker = BenchBroker(folder, name, more).start()
    stack.callback(broker.kill)
    return broker


class _Station:
    """Counts the states that arrive at the cloud broker, by topics or in bundles."""

    def __init__(self) -> None:
        self.states = 0
        self.sessions: dict[str, int] = {}
        self.client: RawClient

    @classmethod
    async def at(cls, cloud: BenchBroker, stack: ExitStack) -> _Station:
        station = cls()
        station.client = await RawClient.connect(cloud.port, "bench-station", station._heard)
        stack.callback(station.client.close)
        await station.client.subscribe("+/+/state/#", "+/states", "+/reachable")
        return station

    async def register(self, seal: Seal | None, fog: int = 1, bundles: bool = False) -> None:
        """Register for ten minutes; with a seal as in a fleet that signs: for the activator's session, until a time."""
        topic = f"fog{fog}/init_connect"
        message = Registration(name="bench", session=7, nonce=1, lease_s=600, bundles=bundles)
        if seal is None:
            self.client.publish(topic, encode(message), qos=1)
            return
        await eventually(lambda: f"fog{fog}/reachable" in self.sessions, "the activator's birth")
        session = self.sessions[f"fog{fog}/reachable"]
        signed = replace(message, activator_session=session, counter=1, until_ms=2**40)
        self.client.publish(topic, seal.sign(topic, encode(signed), with_certificate=True).encode(), qos=1)

    def _heard(self, topic: str, payload: bytes) -> None:
        if topic.endswith("/reachable"):
            if topic.count("/") == 1:
                self.sessions[topic] = decode(FogPresence, inside(payload)).session
            return
        self.states += len(states_of(decode(FogBundle, payload))) if topic.endswith("/states") else 1


async def _relayed(fleets: list[Fleet], station: _Station, hz: float, pids: list[int]) -> Relayed:
    for fleet in fleets:
        await fleet.start()
    count = sum(len(fleet) for fleet in fleets) * len(FIVE)

    while station.states < count:  # drones become reachable one by one, and their states are relayed from then on
        await _send(fleets, 1.0, 1.0)
    await _send(fleets, hz, WARM_UP_S)
    await _settled(station)
    before = (time.monotonic(), cpu_s(*pids), sum(fleet.sent for fleet in fleets), station.states)
    await _send(fleets, hz, WINDOW_S)
    sent_s = time.monotonic()
    await _settled(station)
    used_s = cpu_s(*pids) - before[1]
    states = station.states - before[3]
    sent = sum(fleet.sent for fleet in fleets) - before[2]
    for fleet in fleets:
        fleet.close()
    return Relayed(states, sent - states, sent_s - before[0], used_s, sum(rss_mb(pid) for pid in pids))


async def _send(fleets: list[Fleet], hz: float, lasting_s: float) -> None:
    """Send every state `hz` times per second, spread evenly over time."""
    loop = asyncio.get_running_loop()
    parts = round(1 / hz / SLICE_S)
    started = loop.time()
    for tick in range(round(lasting_s / SLICE_S)):
        for fleet in fleets:
            fleet.send_part(tick % parts, parts)
        await asyncio.sleep(max(0, started + (tick + 1) * SLICE_S - loop.time()))


async def _settled(station: _Station) -> None:
    """Wait until nothing more arrives."""
    last = -1
    while station.states != last:
        last = station.states
        await asyncio.sleep(QUIET_S)
