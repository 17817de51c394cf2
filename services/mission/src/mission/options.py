"""A mission's options, checked at its start: an error is one line with the option, its value and the expectation."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

PROTOCOLS = ("mqttxt", "mavlink")
MOST_SAMPLES = 600
MOST_COUNT = 1000
MESSAGES = "messages"
QOS = ("0", "1")
STATES = ("on-change", "fixed", "bundle")
STREAMS = ("px4-onboard", "px4-gcs", "five-states")
COMMANDINGS = ("one-by-one", "concurrent")
_URL = re.compile(r"(udpin|udpout|tcpin|tcpout)://[^/\s:]+:\d{1,5}|serial:///\S+:\d+")


@dataclass(frozen=True)
class Options:
    """A mission's options: `fleet` has each fog's drones; `urls` are MAVSDK's connections, in the order of drones."""

    scenario: str
    protocol: str
    fleet: dict[int, tuple[int, ...]]
    cloud: str
    qos: str
    states: str
    urls: tuple[str, ...]
    streams: str
    commanding: str
    samples: int = 1
    sensors: Path | None = None
    series: Path | None = None
    sensor_broker: str = ""
    links_start: Path | None = None
    count: int = 1
    control: Path | None = None
    identity: Path | None = None
    signed: bool = False
    gateway: bool = False

    def check(self, scenarios: tuple[str, ...], with_sensors: tuple[str, ...]) -> None:
        """Raises ValueError naming the option that does not fit."""
        _one_of("scenario", self.scenario, scenarios)
        _one_of("--protocol", self.protocol, PROTOCOLS)
        _one_of("--qos", self.qos, QOS)
        _one_of("--states", self.states, STATES)
        _one_of("--streams", self.streams, STREAMS)
        _one_of("--commanding", self.commanding, COMMANDINGS)
        if self.gateway and (self.protocol != "mqttxt" or self.scenario in (*with_sensors, MESSAGES)):
            raise ValueError(f"--gateway: {self.scenario} over {self.protocol}: expected another scenario over mqttxt")
        if self.protocol == "mqttxt" and not self.cloud:
            raise ValueError("--cloud '': expected the cloud broker, mqtt://HOST[:PORT]")
        if not 1 <= self.samples <= MOST_SAMPLES:
            raise ValueError(f"--samples {self.samples}: expected 1 to {MOST_SAMPLES}")
        if self.links_start is not None:
            _check_makeable("--links-start", self.links_start)
        if self.scenario == MESSAGES:
            self._check_messages()
        if self.scenario in with_sensors:
            self._check_sensors()
        drones = sum(len(drones) for drones in self.fleet.values())
        if self.protocol == "mavlink" and len(self.urls) not in (1, drones):
            raise ValueError(f"--mavlink: {len(self.urls)} connections for {drones} drones: expected 1 or {drones}")

    def _check_messages(self) -> None:
        drones = [drone for drones in self.fleet.values() for drone in drones]
        if len(drones) != 1:
            raise ValueError(f"--fleet: {len(drones)} drones: expected one for {self.scenario}, as 1:1")
        if not 1 <= self.count <= MOST_COUNT:
            raise ValueError(f"--count {self.count}: expected 1 to {MOST_COUNT}")
        if self.control is None:
            raise ValueError(f"{self.scenario}: expected --control, the control socket of the autopilot's stand-in")

    def _check_sensors(self) -> None:
        if self.sensors is None:
            raise ValueError(f"{self.scenario}: expected --sensors, the folder of what the sensors write down")
        if self.series is None:
            raise ValueError(f"{self.scenario}: expected --series, a file for what arrived of it")
        _check_makeable("--series", self.series)
        if self.protocol == "mavlink" and not self.sensor_broker:
            raise ValueError(f"{self.scenario}: expected --sensor-broker, where readings arrive: mqtt://HOST[:PORT]")


def parse_fleet(text: str) -> dict[int, tuple[int, ...]]:
    """Parse `1:1,2,3;2:4,5,6` into fogs and their drones, each named once. Raises ValueError."""
    try:
        pairs = [part.split(":") for part in text.split(";")]
        found = [(int(fog), tuple(int(drone) for drone in drones.split(","))) for fog, drones in pairs]
    except ValueError:
        raise ValueError(f"--fleet {text!r}: expected FOG:DRONE,DRONE;FOG:DRONE, as 1:1,2,3;2:4,5,6") from None
    drones = [drone for _, drones in found for drone in drones]
    if len(set(drones)) < len(drones) or len(dict(found)) < len(found):
        raise ValueError(f"--fleet {text!r}: expected each fog and each drone once")
    return dict(found)


def parse_urls(text: str) -> tuple[str, ...]:
    """Parse MAVSDK's connections from a list with commas. Raises ValueError naming an invalid one."""
    urls = tuple(part.strip() for part in text.split(","))
    for url in urls:
        if not _URL.fullmatch(url):
            raise ValueError(f"--mavlink {url!r}: expected udpin://HOST:PORT, as udpin://0.0.0.0:14540")
    return urls


def _check_makeable(option: str, path: Path) -> None:
    """Raises ValueError for a file that exists, or whose folder cannot be written."""
    if path.exists():
        raise ValueError(f"{option} {path}: expected a file that is not there yet")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise ValueError(f"{option} {path}: expected a folder that can be written to")


def _one_of(what: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{what} {value!r}: expected one of {', '.join(known)}")
