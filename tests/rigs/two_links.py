"""A fog with two brokers, or two links to one, as real processes: drone 1 reaches it over two links that can fail."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Hashable
from pathlib import Path

from mqttxt import GroundStation, Outcome, Reachability
from mqttxt.security.authority import Authority
from tests.rigs.flaky_link import FlakyLink
from tests.rigs.loopback import eventually
from tests.rigs.one_drone import OneDrone


class TwoLinkSystem(OneDrone):
    """A fog with a second broker, and drone 1, which reaches it over two links; `mode` is "", TLS or SIGNED.

    With `one_broker` both links lead to the fog's first broker. `second_of` is the second broker's fleet, if it differs
    from the nodes'. `knows_second`: whether the activator connects to that broker; `has_second`: whether it starts
    with the others. `ppm`: the rate of the drone's clock. Without `two_links` the drone has only the first link.
    """

    def __init__(
        self,
        folder: Path,
        mode: str = "",
        *,
        one_broker: bool = False,
        second_of: Authority | None = None,
        knows_second: bool = True,
        has_second: bool = True,
        ppm: int | None = None,
        two_links: bool = True,
    ) -> None:
        super().__init__(folder, mode)
        self.second = self.broker("fog1", second_of or self.acme, "second")
        self.brokers += [self.second] if has_second else []
        there = self.fog if one_broker else self.second
        self.links = FlakyLink(self.fog.port), FlakyLink(there.port)
        first, second = (self.url(link.port) for link in self.links)
        is_known = two_links and knows_second and not one_broker
        self.run(
            ["--second-fog-broker", self.url(self.second.port)] if is_known else [],
            ["--broker", first, *(["--second-broker", second] if two_links else [])],
            ppm,
        )

    async def begin(self) -> None:
        for link in self.links:
            await link.start()
        await super().begin()

    async def end(self) -> None:
        await super().end()
        self.second.kill()
        for link in self.links:
            await link.close()

    def connections(self, number: int) -> int:
        """How often the UAV client has connected over link `number`, 1 or 2."""
        return self.uav.said().count(f"fog: connected to {self.url(self.links[number - 1].port)}")

    async def connected_again(self, number: int, before: int) -> None:
        await eventually(lambda: self.connections(number) > before, f"link {number} is up again")

    def in_use(self) -> int:
        """The link that the UAV client prefers at present, 1 or 2."""
        _, taken, rest = self.uav.said().rpartition("fog: over ")
        return 2 if taken and rest.startswith(self.url(self.links[1].port)) else 1

    def turns(self) -> list[str]:
        """The autopilot's events `armed` and `disarmed`, in order."""
        lines = (self.folder / "sitl.jsonl").read_text().splitlines()
        events = [json.loads(line)["event"] for line in lines if line.endswith("}")]
        return [event for event in events if event in ("armed", "disarmed")]


class Watch:
    """Records what a station receives: losses of drones, and how many last words each command had."""

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
