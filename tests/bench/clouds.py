"""The cloud of a load: one Mosquitto, or the three RabbitMQ nodes of `deploy/cluster`, with identities and TLS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tests.bench.brokers import BenchBroker, TwoWayBroker, cpu_s, rss_mb
from tests.rigs.cluster import Cluster

STATION, FOG_BROKER = "gs-ops", "broker-fog1"
Plan = list[tuple[str, int, int, int]]
"""The prefix, number, first and last drone of each fog."""


@dataclass(frozen=True)
class Reached:
    """How a fleet's nodes reach its brokers.

    `url` is the cloud's, `fog_url` the fogs' for activators, `drone_url` the same for drones; below `identities` are
    those of the fleet's nodes, if they have any.
    """

    url: str
    fog_url: str
    drone_url: str
    identities: Path | None = None

    def identity(self, name: str) -> Path | None:
        return None if self.identities is None else self.identities / name


class Cloud(Protocol):
    """`fleets` has what each fleet reaches, by its prefix."""

    fleets: dict[str, Reached]

    def start(self) -> None: ...
    def close(self) -> None: ...

    def cpu_s(self) -> float: ...
    def rss_mb(self) -> float: ...


class OneMosquitto:
    """One process for the cloud and all fogs."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self._broker = BenchBroker(folder, "cloud")
        url = self._broker.url
        self.fleets = {prefix: Reached(url, url, url) for prefix, *_ in plan}

    def start(self) -> None:
        self._broker.start()

    def close(self) -> None:
        self._broker.kill()

    def cpu_s(self) -> float:
        return cpu_s(self._broker.pid)

    def rss_mb(self) -> float:
        return rss_mb(self._broker.pid)


class ThreeNodes:
    """The cluster; the fogs of a fleet share a Mosquitto, whose cost is not the cloud's."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self._cluster = Cluster(folder)
        self._fogs = []
        self.fleets = {}
        for prefix in dict.fromkeys(prefix for prefix, *_ in plan):
            fogs = (f"fog{fog}" for at, fog, _, _ in plan if at == prefix)
            fleet = self._cluster.add(prefix.rstrip("/"), (FOG_BROKER, *fogs), prefix)
            fog = TwoWayBroker(folder, f"fogs-{prefix.rstrip('/')}", fleet.identity(FOG_BROKER))
            self._fogs.append(fog)
            self.fleets[prefix] = Reached(fleet.url, fog.tls_url, fog.url, fleet.authority.folder)

    def start(self) -> None:
        for fog in self._fogs:
            fog.start()
        self._cluster.start()

    def close(self) -> None:
        self._cluster.close()
        for fog in self._fogs:
            fog.kill()

    def cpu_s(self) -> float:
        """Processor time of the three nodes and the balancer."""
        return sum(float(each["cpu_stats"]["cpu_usage"]["total_usage"]) for each in self._stats()) / 1e9

    def rss_mb(self) -> float:
        """Memory as in `docker stats`: without the kernel's cache of files."""
        memory = [each["memory_stats"] for each in self._stats()]
        return sum(float(each["usage"] - each["stats"].get("inactive_file", 0)) for each in memory) / 1e6

    def _stats(self) -> list[dict[str, Any]]:
        return [container.stats(stream=False, one_shot=True) for container in self._cluster.containers()]


MOSQUITTO = "mosquitto"
CLOUDS: dict[str, Callable[[Path, Plan], Cloud]] = {MOSQUITTO: OneMosquitto, "cluster": ThreeNodes}
