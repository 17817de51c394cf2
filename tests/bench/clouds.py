"""The cloud of a load: one Mosquitto, or the three RabbitMQ nodes of `deploy/cluster`, with identities and TLS."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from tests.bench.brokers import BenchBroker, TwoWayBroker, cpu_s, rss_mb
from tests.rigs.cluster import Cluster

STATION, FOG_BROKER = "gs-ops", "broker-fog1"
Plan = list[tuple[str, int, int, int]]
"""The prefix, number, first and last drone of each fog."""


class Cloud(Protocol):
    """`fog_url` is the fogs' broker as activators reach it, `drone_url` the same as drones reach it."""

    @property
    def url(self) -> str: ...
    @property
    def fog_url(self) -> str: ...
    @property
    def drone_url(self) -> str: ...
    def start(self) -> None: ...
    def close(self) -> None: ...
    def identity(self, name: str) -> Path | None:
        """A node's identity; None where nodes have none."""
        ...

    def cpu_s(self) -> float: ...
    def rss_mb(self) -> float: ...


class OneMosquitto:
    """One process for the cloud and all fogs."""

    def __init__(self, folder: Path, _plan: Plan) -> None:
        self._broker = BenchBroker(folder, "cloud")
        self.url = self.fog_url = self.drone_url = self._broker.url

    def start(self) -> None:
        self._broker.start()

    def close(self) -> None:
        self._broker.kill()

    def identity(self, name: str) -> Path | None:
        return None

    def cpu_s(self) -> float:
        return cpu_s(self._broker.pid)

    def rss_mb(self) -> float:
        return rss_mb(self._broker.pid)


class ThreeNodes:
    """The cluster of one fleet; all fogs share a Mosquitto, whose cost is not the cloud's."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        members = ("broker-cloud", FOG_BROKER, *(f"fog{fog}" for _, fog, _, _ in plan))
        (prefix,) = {prefix for prefix, *_ in plan}
        self._cluster = Cluster(folder, members, prefix)
        self._fog = TwoWayBroker(folder, "fog", self._cluster.acme.folder / FOG_BROKER)
        self.url, self.fog_url, self.drone_url = self._cluster.url, self._fog.tls_url, self._fog.url

    def start(self) -> None:
        self._fog.start()
        self._cluster.start()

    def close(self) -> None:
        self._cluster.close()
        self._fog.kill()

    def identity(self, name: str) -> Path | None:
        return self._cluster.acme.folder / name

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
