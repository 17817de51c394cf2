"""A fog with two brokers, or two ways to one, as real processes: drone 1 reaches it over two links that can fail."""

from __future__ import annotations

import asyncio
import json
import socket
from collections import Counter
from collections.abc import Hashable
from pathlib import Path
from typing import Self

from mqttxt import GroundStation, Outcome, Reachability
from mqttxt.security.authority import Authority
from mqttxt.security.rights import Rights
from tests.quick import LANDING, quick_fleet
from tests.rigs.flaky_link import FlakyLink
from tests.rigs.loopback import eventually, free_port
from tests.rigs.processes import Broker, Process, commanded
from tests.rigs.secure import SecureBroker

TLS, SIGNED = "tls", "signed"
STATION = Rights(None, take_over=True, observe=True)


class TwoLinkSystem:
    """Cloud, fog and second broker, activator, drone 1 and its autopilot; `mode` is "", TLS or SIGNED.

    With `one_broker` both links lead to the fog's broker. `second_of` is the fleet of the second broker, where it is
    another than the nodes'. `knows_second`: whether the activator is connected to it. `ppm`: the drone's clock. Without
    `two_links` the drone has the first alone.
    """

    def __init__(
        self,
        folder: Path,
        mode: str = "",
        *,
        one_broker: bool = False,
        second_of: Authority | None = None,
        knows_second: bool = True,
        ppm: int | None = None,
        two_links: bool = True,
    ) -> None:
        self.folder = folder
        self.acme = Authority.create(folder / "acme", "acme") if mode else None
        if self.acme is not None:
            for name in ("fog1", "drone1"):
                self.acme.issue(name)
            self.acme.issue("gs-ops", STATION)
        self.cloud, self.fog = self._broker("cloud", self.acme), self._broker("fog1", self.acme)
        self.second = self._broker("fog1", second_of or self.acme, "second")
        self._scheme = "mqtts" if mode else "mqtt"
        there = self.fog if one_broker else self.second
        self.links = FlakyLink(self.fog.port), FlakyLink(there.port)
        autopilot = free_port(socket.SOCK_DGRAM)
        fleet = str(quick_fleet(folder, LANDING))
        sitl = ["fly", "--fleet", fleet, "--system", "1", "--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{autopilot}"]
        self.sitl = self._process("sitl", "sitl", *sitl, "--events", str(folder / "sitl.jsonl"))
        urls = [self._url(broker.port) for broker in (self.cloud, self.fog)]
        activator = ["activator", "--fog", "1", "--cloud", urls[0], "--fog-broker", urls[1], "--drones", "1"]
        if two_links and knows_second and not one_broker:
            activator += ["--second-fog-broker", self._url(self.second.port)]
        uav = ["uav", "--drone", "1", "--autopilot", f"udp:127.0.0.1:{autopilot}", "--journal", str(folder / "journal")]
        uav += ["--broker", self._url(self.links[0].port)]
        uav += ["--second-broker", self._url(self.links[1].port)] if two_links else []
        if self.acme is not None:
            activator += ["--identity", str(self.acme.folder / "fog1")]
            uav += ["--identity", str(self.acme.folder / "drone1")]
        if mode == SIGNED:
            activator, uav = [*activator, "--signed"], [*uav, "--signed", "--fog", "1"]
        self.is_signed = mode == SIGNED
        self.activator = self._process("activator", "mqttxt", *activator)
        self.uav = self._process("uav", "mqttxt", *uav, ppm=ppm)

    def _broker(self, of: str, authority: Authority | None, called: str | None = None) -> Broker | SecureBroker:
        if authority is None:
            return Broker(self.folder, called or of)
        name = f"broker-{of}"
        if not (authority.folder / name).exists():
            authority.issue(name)
        return SecureBroker(authority, name, called=called)

    def _url(self, port: int) -> str:
        return f"{self._scheme}://127.0.0.1:{port}"

    def _process(self, name: str, module: str, *arguments: str, ppm: int | None = None) -> Process:
        ready = str(self.folder / f"{name}.ready")
        return Process(self.folder, name, module, *arguments, "--ready-file", ready, ppm=ppm)

    @property
    def _processes(self) -> tuple[Process, ...]:
        return self.sitl, self.activator, self.uav

    async def start(self, *, with_second: bool = True) -> Self:
        for link in self.links:
            await link.start()
        for broker in (self.cloud, self.fog, *((self.second,) if with_second else ())):
            await asyncio.to_thread(broker.start)
        for process in self._processes:
            process.start()
        for process in self._processes:
            await asyncio.to_thread(process.wait_ready)
        return self

    async def close(self) -> None:
        for process in self._processes:
            process.kill()
        for broker in (self.cloud, self.fog, self.second):
            broker.kill()
        for link in self.links:
            await link.close()

    def station(self) -> GroundStation:
        folder = self.acme.folder / "gs-ops" if self.acme is not None else None
        return GroundStation(self._url(self.cloud.port), identity=folder, signed=self.is_signed)

    def connections(self, number: int) -> int:
        """How often the drone's client has connected over its first or second link."""
        return self.uav.said().count(f"fog: connected to {self._url(self.links[number - 1].port)}")

    async def connected_again(self, number: int, before: int) -> None:
        await eventually(lambda: self.connections(number) > before, f"link {number} is up again")

    def in_use(self) -> int:
        """Which link the drone's client has last taken for the better."""
        _, taken, rest = self.uav.said().rpartition("fog: over ")
        return 2 if taken and rest.startswith(self._url(self.links[1].port)) else 1

    def commanded(self, mav_cmd: int) -> int:
        """How often the autopilot was sent a MAV_CMD."""
        return len(commanded(self.folder / "sitl.jsonl", mav_cmd))

    def turns(self) -> list[str]:
        """What the autopilot did: armed and disarmed, in order."""
        lines = (self.folder / "sitl.jsonl").read_text().splitlines()
        events = [json.loads(line)["event"] for line in lines if line.endswith("}")]
        return [event for event in events if event in ("armed", "disarmed")]


class Watch:
    """What a station hears of drones that are gone, and how often each command had a last word."""

    def __init__(self, station: GroundStation) -> None:
        self.losses: list[Reachability] = []
        self.last_words: Counter[Hashable] = Counter()
        self._task = asyncio.create_task(self._watch(station))

    async def _watch(self, station: GroundStation) -> None:
        async for said in station.events():
            if isinstance(said, Reachability) and not said.reachable:
                self.losses.append(said)
            elif isinstance(said, Outcome) and said.is_last:
                self.last_words[said.id] += 1

    @property
    def doubled(self) -> list[Hashable]:
        return [command_id for command_id, count in self.last_words.items() if count > 1]
