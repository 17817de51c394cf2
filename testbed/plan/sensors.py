"""The sensors of scenario 4: where they stand, how far they reach, and what their containers and missions are told."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import yaml

from ..errors import UserError
from .profiles.run_plan import Gate
from .topology import COMPOSE_FILE, ROOT, SENSOR, read_services, read_topology

POINTS_FILE = ROOT / "services" / "mission" / "src" / "mission" / "points.yaml"
FOLDER, SERIES = "/run-dir/sensors", "/run-dir/series.json"
CLOUD_URL = "mqtt://198.18.1.3:1883"
UAV_BROKER = "0.0.0.0:1883"
STORE = "/var/lib/mqttxt/sensors"
SENSOR_PROFILES = ("sensors", "mavlink-sensors")
"""compose.yaml's profiles of what only runs with sensors."""


def read_gates(path: Path = POINTS_FILE) -> tuple[Gate, ...]:
    """A gate for each drone's sensor, which stands at its point. Raises UserError for a file that has no points."""
    try:
        table = yaml.safe_load(path.read_text(encoding="utf-8"))
        range_m = float(table["range_m"])
        gates = [
            Gate(f"sense:uav{drone}", int(drone), float(point["latitude_deg"]), float(point["longitude_deg"]), range_m)
            for drone, point in table["points"].items()
        ]
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: expected range_m and points: {' '.join(str(error).split())}") from error
    return tuple(gates)


def closed_links(gates: Sequence[Gate]) -> dict[str, str]:
    """The links that no probe passes before the drones fly, and why."""
    return {gate.link: "its drone is out of range" for gate in gates}


def sensor_profiles(protocol: str) -> tuple[str, ...]:
    """The profiles that run beside a protocol's own."""
    return SENSOR_PROFILES if protocol == "mavlink" else SENSOR_PROFILES[:1]


def sensor_settings(protocol: str, samples: int, path: Path = COMPOSE_FILE) -> dict[str, str]:
    """What compose.yaml's variables are with sensors; net's part of it is told from the nodes' own entries."""
    services = read_services(path)
    topology = read_topology(path, sensors=True)
    nodes = [node for node in topology.nodes if node.name.startswith(SENSOR)]
    gateways = {node.name: services[node.name]["environment"]["GATEWAY"] for node in nodes}
    pairs = [(link.upper, link.lower) for link in topology.links if link.name.startswith("sense:")]
    return {
        "SAMPLES": str(samples),
        "SENSOR_NODES": " ".join(f"{node.name}={gateways[node.name]},{node.address}" for node in nodes),
        "SENSOR_LINKS": " ".join(f"{upper}-{lower}" for upper, lower in pairs),
        "SENSOR_FLAG": "--plain" if protocol == "mavlink" else "",
        "SENSORS_FLAG": f"--sensors {UAV_BROKER} --sensor-store {STORE}" if protocol == "mqttxt" else "",
        "SENSOR_PROFILES": " ".join(sensor_profiles(protocol)),
    }


def sensor_words(protocol: str, samples: int) -> list[str]:
    """What `mission fly` is told beside the rest."""
    words = ["--samples", str(samples), "--sensors", FOLDER, "--series", SERIES]
    return [*words, "--sensor-broker", CLOUD_URL] if protocol == "mavlink" else words
