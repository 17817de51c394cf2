"""A ground station's view of its fogs, as Prometheus metrics (docs/metrics.md)."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from prometheus_client import CollectorRegistry, make_wsgi_app, start_http_server
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from .core.address import BrokerAddress, host_port
from .core.floods import FirstReadings
from .errors import ConfigurationError
from .protocol.fields import Named
from .protocol.state_fields import fields_of
from .protocol.states import STATES, AutopilotText
from .station.views import Drone, Fog

Answering = Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]
SNAPSHOT_S = 5.0
"""How long a scrape waits for the event loop, s."""
_WORDS = {
    "mqttxt_fog_live": "Whether the fog's activator is there.",
    "mqttxt_drone_reachable": "Whether the drone is reachable.",
    "mqttxt_drone_controlled": "Whether a ground station controls the drone.",
    "mqttxt_drone_rank": "The drone's place in its fog's ranking (QoDS), 1 is best.",
    "mqttxt_state_age_seconds": "How old the newest value of a state is, at the most.",
    "mqttxt_sensor_reading": "The newest reading of a sensor that the drone carries for.",
    "mqttxt_sensor_reading_time_seconds": "When that was measured, by the sensor's clock (Unix time).",
}


class Families:
    """The samples of one scrape, by the name of their metric."""

    def __init__(self) -> None:
        self._found: dict[str, GaugeMetricFamily] = {}

    def add(self, name: str, value: float, labels: dict[str, str]) -> None:
        family = self._found.get(name)
        if family is None:
            family = self._found[name] = GaugeMetricFamily(name, _WORDS.get(name, f"See {name} in docs/protocol.md."))
        family.add_sample(name, labels, value)

    def all(self) -> list[Metric]:
        return list(self._found.values())


class FleetCollector(Collector):
    """Collects metrics from fogs; scrapes arrive in a thread of their own, and wait for the stations' event loop."""

    def __init__(self, fogs: Sequence[Fog], loop: asyncio.AbstractEventLoop) -> None:
        self._fogs = fogs
        self._loop = loop
        self._readings = FirstReadings()

    def describe(self) -> Iterable[Metric]:
        """Nothing: the metrics are known only at a scrape, because they depend on the states."""
        return []

    def collect(self) -> Iterable[Metric]:
        return asyncio.run_coroutine_threadsafe(self._snapshot(), self._loop).result(SNAPSHOT_S)

    async def _snapshot(self) -> list[Metric]:
        families = Families()
        for fog in self._fogs:
            self._add_fog(families, fog)
        return families.all()

    def _add_fog(self, families: Families, fog: Fog) -> None:
        of_fog = {"fleet": fog.fleet, "fog": str(fog.number)} if fog.fleet else {"fog": str(fog.number)}
        families.add("mqttxt_fog_live", fog.is_live, of_fog)
        ranks = {ranked.drone: place for place, ranked in enumerate(fog.ranking, start=1)}
        for drone in fog.drones:
            labels = {**of_fog, "drone": str(drone.number)}
            families.add("mqttxt_drone_reachable", drone.is_reachable, labels)
            families.add("mqttxt_drone_controlled", drone.holder is not None, labels)
            if drone.is_reachable:
                if drone.number in ranks:
                    families.add("mqttxt_drone_rank", ranks[drone.number], labels)
                _add_states(families, drone, labels)
            for reading in drone.readings:
                if self._readings.takes((fog.fleet, drone.number), (reading.sensor, reading.kind, reading.unit)):
                    of_sensor = {**labels, "sensor": str(reading.sensor), "kind": reading.kind}
                    families.add("mqttxt_sensor_reading", reading.value, {**of_sensor, "unit": reading.unit})
                    families.add("mqttxt_sensor_reading_time_seconds", reading.time_ms / 1000, of_sensor)


def _add_states(families: Families, drone: Drone, labels: dict[str, str]) -> None:
    """Add a drone's states; an unknown figure has no sample, so that a chart shows a gap."""
    for name, known in drone.states.items():
        if name not in STATES or name == AutopilotText.name:
            continue
        if known.age_ms is not None:
            families.add("mqttxt_state_age_seconds", known.age_ms / 1000, {**labels, "state": name})
        for field, alone in fields_of(name).items():
            metric, value = f"mqttxt_{alone}", getattr(known.state, field)
            if isinstance(value, Named):
                families.add(metric, 1, {**labels, field: value.label})
            elif value is not None:
                families.add(metric, float(value), labels)


def serve(fogs: Sequence[Fog], host: str, port: int) -> None:
    """Answer scrapes at `http://HOST:PORT/metrics` until the process ends; raises ConfigurationError."""
    registry = CollectorRegistry()
    registry.register(FleetCollector(fogs, asyncio.get_running_loop()))
    try:
        server, _ = start_http_server(port, host, CollectorRegistry())  # an empty one: it answers anyone at once
    except OSError as error:
        raise ConfigurationError(
            f"--listen {host_port(host, port)}: cannot listen: {error.strerror or error}"
        ) from error
    app = make_wsgi_app(registry)
    server.set_app(_for_this_machine(app) if BrokerAddress(host, port).is_loopback else app)


def _for_this_machine(app: Answering) -> Answering:
    """Wrap an app at loopback so that it answers only requests for this machine's names, against DNS rebinding."""

    def answering(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        name = re.sub(r":[0-9]*$", "", environ.get("HTTP_HOST", "")).strip("[]")
        if BrokerAddress(name, 1).is_loopback:
            return app(environ, start_response)
        start_response("403 Forbidden", [("Content-Type", "text/plain")])
        return [b"expected 127.0.0.1 or localhost\n"]

    return answering
