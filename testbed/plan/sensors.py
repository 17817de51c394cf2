"""The sensors of scenario 4: their places, their range, and their settings."""

from __future__ import annotations

from collections.abc import Sequence

from net.link_plan import Gate

from .fleet import Fleet

FOLDER, SERIES = "/run-dir/sensors", "/run-dir/series.json"
STORE = "/var/lib/mqttxt/sensors"
SENSOR_PROFILES = ("sensors", "mavlink-sensors")
"""The profiles of compose.yaml for services that only run with sensors."""


def gates_of(fleet: Fleet) -> tuple[Gate, ...]:
    """A gate for each drone's sensor, which is at the drone's point."""
    points = {drone: fleet.drones[drone]["point"] for drone in fleet.fog_of}
    return tuple(
        Gate(f"sense:uav{drone}", drone, point["latitude_deg"], point["longitude_deg"], fleet.sensor_range_m)
        for drone, point in points.items()
    )


def closed_links(gates: Sequence[Gate]) -> dict[str, str]:
    """The links that pass no probe before the drones fly, with the reason."""
    return {gate.link: "its drone is out of range" for gate in gates}


def sensor_profiles(protocol: str) -> tuple[str, ...]:
    """The profiles that run in addition to a protocol's own."""
    return SENSOR_PROFILES if protocol == "mavlink" else SENSOR_PROFILES[:1]


def sensor_settings(fleet: Fleet, protocol: str, samples: int, *, secured: bool = False) -> dict[str, str]:
    """The values of compose.yaml's variables with sensors; `secured`: in TLS."""
    listen = f"0.0.0.0:{8883 if secured else 1883}"
    nodes = [f"sensor{drone}" for drone in fleet.fog_of]
    return {
        "SAMPLES": str(samples),
        "SENSOR_NODES": " ".join(f"{node}={fleet.gateway(node)},{fleet.address(node)}" for node in nodes),
        "SENSOR_LINKS": " ".join(f"uav{drone}-sensor{drone}" for drone in fleet.fog_of),
        "SENSOR_FLAG": "--plain" if protocol == "mavlink" else "",
        "SENSORS_FLAG": f"--sensors {listen} --sensor-store {STORE}" if protocol == "mqttxt" else "",
        "SENSOR_PROFILES": " ".join(sensor_profiles(protocol)),
    }


def sensor_words(fleet: Fleet, protocol: str, samples: int) -> list[str]:
    """The options of `mission fly` for sensors."""
    words = ["--samples", str(samples), "--sensors", FOLDER, "--series", SERIES]
    return [*words, "--sensor-broker", fleet.broker_url("cloud")] if protocol == "mavlink" else words
