"""Two fleets in one cloud, as real processes: each has a fog 1 with the drones 1 and 2, and an autopilot for each."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

from tests.rigs.processes import Broker, Process, System

FLYING = {"arm": 400, "takeoff": 22, "land": 21, "mode": 176, "reposition": 192, "parameter": 180}
"""The commands by which an autopilot is flown, as MAV_CMD."""


class OneFleet(System):
    """A fleet below a prefix, in a cloud that others use too."""

    def __init__(self, folder: Path, cloud: Broker, prefix: str) -> None:
        folder.mkdir()
        self.prefix = prefix
        self.shared = cloud
        super().__init__(folder)

    @property
    def brokers(self) -> tuple[Broker, ...]:
        return (self.fog,)

    def make_activator(self, cloud: str, fog: str, name: str = "activator", ppm: int | None = None) -> Process:
        return super().make_activator(self.shared.url, fog, name, ppm).with_more("--prefix", self.prefix)

    def make_uav(self, drone: int, broker: str, **how: Any) -> Process:
        return super().make_uav(drone, broker, **how).with_more("--endurance-s", "700")

    def flown(self, drone: int) -> dict[str, int]:
        """How often an autopilot received each of FLYING; those that it did not receive are left out."""
        found = {name: len(self.commanded(drone, number)) for name, number in FLYING.items()}
        return {name: count for name, count in found.items() if count > 0}


class TwoFleets:
    """The fleets `acme` and `acme/eu`, the second with a prefix that begins with the first's, and their cloud."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cloud = Broker(folder, "cloud")
        self.acme = OneFleet(folder / "acme", self.cloud, "acme/")
        self.eu = OneFleet(folder / "eu", self.cloud, "acme/eu/")

    def start(self) -> Self:
        self.cloud.start()
        self.acme.start()
        self.eu.start()
        return self

    def close(self) -> None:
        self.acme.close()
        self.eu.close()
        self.cloud.kill()
