"""An attempt with sensors made by hand: readings over plain brokers beside MAVLink, in bytes that Mosquitto sent."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from testbed.fly.results import Attempt, Series, new_attempt, write_json
from tests.handmade.attempts import SECOND, T0, called, frame, manifest, topology_of, write_captures, write_lines

MS = SECOND // 1000
NODES = {
    **{"gs": "198.18.0.3", "cloud": "198.18.1.3", "fog1": "198.18.11.3", "uav1": "198.18.21.3"},
    **{"uav2": "198.18.22.3", "sensor1": "198.18.31.3", "sensor2": "198.18.32.3"},
}
LINKS = [
    *(("wan:gs", "gs", "cloud"), ("backhaul:fog1", "fog1", "cloud"), ("air:uav1", "uav1", "fog1")),
    *(("air:uav2", "uav2", "fog1"), ("sense:uav1", "sensor1", "uav1"), ("sense:uav2", "sensor2", "uav2")),
]
MEASURED_MS = 1_795_291_410_455
"""When the sensor measured the values in these bytes, by the clock of a run."""
BOOT = 0xC26395D8
ABOUT = {"sensor": 1, "boot": BOOT, "time_ms": MEASURED_MS}
TEMPERATURE = {**ABOUT, "seq": 0, "kind": "temperature", "value": 16.6, "unit": "degC"}
HUMIDITY = {**ABOUT, "seq": 1, "kind": "humidity", "value": 57.1, "unit": "%"}
LIGHT = {**ABOUT, "seq": 2, "kind": "light", "value": 0.0, "unit": "lx"}

CONNECT = bytes.fromhex("101d00044d5154540500000f032103e8000d6272696467652d64726f6e6531")
CONNACK = bytes.fromhex("200e00000b22100027000100002103e8")
SUBSCRIBE = bytes.fromhex("821d000100000a666f67312f2b2f2b2f2b01000a666f67322f2b2f2b2f2b01")
SUBACK = bytes.fromhex("90050001000101")
PINGREQ, PINGRESP = bytes.fromhex("c000"), bytes.fromhex("d000")
PUBACK = bytes.fromhex("40020001")
FROM_SENSOR = bytes.fromhex(
    "3232001373656e736f72312f74656d706572617475726500010085011ac26395d8001b000001a1ffb4f017fb403099999999999a"
    "322f001073656e736f72312f68756d696469747900020085011ac26395d8011b000001a1ffb4f017fb404c8ccccccccccd"
    "3224000d73656e736f72312f6c6967687400030085011ac26395d8021b000001a1ffb4f01700"
)
"""Three PUBLISHes in one segment, as a sensor sends the readings of a second."""
FROM_DRONE = {
    "temperature": bytes.fromhex(
        "3239001a64726f6e65312f73656e736f72312f74656d706572617475726500010085011ac26395d8001b000001a1ffb4f017"
        "fb403099999999999a"
    ),
    "humidity": bytes.fromhex(
        "3236001764726f6e65312f73656e736f72312f68756d696469747900020085011ac26395d8011b000001a1ffb4f017fb404c"
        "8ccccccccccd"
    ),
}
"""The PUBLISHes into which the bridge of the drone's broker turns them."""


def from_fog(kind: str) -> bytes:
    """The PUBLISH into which the fog's bridge turns the drone's: the same below its own name."""
    told = FROM_DRONE[kind]
    length = int.from_bytes(told[2:4], "big")
    return bytes([told[0], told[1] + 5]) + (length + 5).to_bytes(2, "big") + b"fog1/" + told[4:]


@dataclass
class Wire:
    """Frames in captures: each enters its link at the sender and leaves it 0.5 ms later at the receiver."""

    captures: dict[str, list[tuple[int, bytes]]] = field(default_factory=lambda: {node: [] for node in NODES})
    sequences: dict[tuple[str, str], int] = field(default_factory=dict)
    identity: int = 0

    def send(self, t_ns: int, source: str, destination: str, body: bytes, arrives: bool = True) -> None:
        """Send one MQTT segment; the client is gs, or else the node further from the ground station."""
        self.identity += 1
        nodes = list(NODES)
        is_client = source == "gs" or (destination != "gs" and nodes.index(source) > nodes.index(destination))
        ports = (40_000, 1883) if is_client else (1883, 40_000)
        sequence = self.sequences.get((source, destination), 0)
        self.sequences[source, destination] = sequence + len(body)
        data = frame(source, destination, body, self.identity, ports, sequence, NODES)
        self.captures[source].append((t_ns, data))
        if arrives:
            self.captures[destination].append((t_ns + MS // 2, data))


def make_attempt(
    series: Series,
    wire: Wire,
    events: list[dict[str, Any]],
    measured: dict[int, list[dict[str, Any]]],
    samples: int = 1,
    **changed: Any,
) -> Attempt:
    """An attempt over MAVLink whose arm command is called at T0; `measured` has each drone's sensor's readings."""
    attempt = new_attempt(series, "mavlink", 1)
    settings = {"qos": 0, "states": "on-change", "streams": "px4-onboard", "SAMPLES": str(samples)}
    told = manifest(experiment="scenario-4", topology=topology_of(NODES, LINKS), configuration=settings, **changed)
    write_json(attempt.path / "manifest.json", told | {"captures": [{"node": n, "dropped": 0} for n in NODES]})
    write_captures(attempt, wire.captures)
    (attempt.path / "sensors").mkdir()
    for drone, readings in measured.items():
        told_by_it = [{"event": "reading", **reading} for reading in readings]
        write_lines(attempt.path / "sensors" / f"sensor{drone}.jsonl", told_by_it)
    asked = called(T0, 1, "arm", 1, fog=None)
    ended = {"t_ns": T0 + 9 * SECOND, "event": "mission_end", "status": "completed", "reason": None}
    write_lines(attempt.path / "events.jsonl", [asked, *events, ended])
    for drone in (1, 2):
        write_lines(attempt.path / "sitl" / f"uav{drone}.jsonl", [{"t_ns": T0 + 8 * SECOND, "event": "disarmed"}])
    return attempt
