"""A tiny series made by hand: one drone, and few enough frames to count them in one's head."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from scapy.layers.inet import IP, TCP
from scapy.layers.l2 import ARP, Ether
from scapy.packet import Raw

from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import Arm
from mqttxt.protocol.messages import CommandMessage
from mqttxt.protocol.state_payload import StampedState, encode_state
from mqttxt.protocol.states import Battery
from mqttxt.protocol.values import Encoding
from testbed.fly.results import Attempt, Series, new_attempt, write_json

NODES = {"gs": "198.18.0.3", "cloud": "198.18.1.3", "fog1": "198.18.11.3", "uav1": "198.18.21.3"}
LINKS = [("wan:gs", "gs", "cloud"), ("backhaul:fog1", "fog1", "cloud"), ("air:uav1", "uav1", "fog1")]
BATTERY = "fog1/drone1/state/battery"
SECOND = 1_000_000_000
T0 = 1_700_000_000 * SECOND


def publish(topic: str, payload: bytes, qos: int = 0) -> bytes:
    """An MQTT 5 PUBLISH without properties."""
    body = len(topic).to_bytes(2, "big") + topic.encode() + (b"\0\1" if qos else b"") + b"\0" + payload
    assert len(body) < 128
    return bytes([0x30 | qos << 1, len(body)]) + body


def frame(
    source: str,
    destination: str,
    body: bytes,
    identity: int,
    ports: tuple[int, int] = (40_000, 1883),
    sequence: int = 0,
    nodes: Mapping[str, str] = NODES,
) -> bytes:
    """14 + 20 + 20 bytes of headers, then the body."""
    packet = Ether(src="02:00:00:00:00:01", dst="02:00:00:00:00:02")
    packet /= IP(src=nodes[source], dst=nodes[destination], id=identity) / TCP(
        sport=ports[0], dport=ports[1], seq=sequence, flags="PA"
    )
    return bytes(packet / Raw(body) if body else packet)


def write_pcap(path: Path, frames: list[tuple[int, bytes]], append: bool = False) -> None:
    """Write a pcap with nanosecond timestamps, or append frames to one."""
    parts = [] if append else [struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 262_144, 1)]
    for t_ns, data in frames:
        parts += [struct.pack("<IIII", t_ns // SECOND, t_ns % SECOND, len(data), len(data)), data]
    with path.open("ab" if append else "wb") as file:
        file.write(b"".join(parts))


def write_captures(
    attempt: Attempt,
    captures: Mapping[str, list[tuple[int, bytes]]],
    dropped: int = 0,
    macs: Mapping[str, str] | None = None,
) -> None:
    """Write each node's capture, its frames in the order of time, and what each says of itself at its end."""
    for node, frames in captures.items():
        write_pcap(attempt.path / "pcap" / f"{node}.pcap", sorted(frames, key=lambda entry: entry[0]))
    told = {"interface": "eth0", "captured": 3, "dropped": dropped}
    counts = [{"node": node, **told, **({"mac": macs[node]} if macs else {})} for node in captures]
    write_json(attempt.path / "pcap" / "captures.json", counts)


def write_only(attempt: Attempt, **captures: list[tuple[int, bytes]]) -> None:
    """Write captures with these frames, and none in those of all other nodes."""
    for node in NODES:
        write_pcap(attempt.path / "pcap" / f"{node}.pcap", captures.get(node, []))


def write_lines(path: Path, lines: Iterable[dict[str, Any]]) -> None:
    """Write events, one in each line."""
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


def add_event(attempt: Attempt, event: dict[str, Any]) -> None:
    """Put an event in its place among the mission's."""
    events = sorted([*attempt.events(), event], key=lambda one: int(one["t_ns"]))
    write_lines(attempt.path / "events.jsonl", events)


def topology_of(nodes: Mapping[str, str], links: Iterable[tuple[str, str, str]]) -> dict[str, Any]:
    """A manifest's topology, of nodes with their addresses and of links with their names and both ends."""
    return {
        "nodes": [{"name": name, "address": address} for name, address in nodes.items()],
        "links": [{"name": name, "lower": lower, "upper": upper} for name, lower, upper in links],
    }


def arm_command() -> bytes:
    message = CommandMessage(gs_session=7, seq=1, executor_session=9, deadline_ms=5000, limit_s=10.0, command=Arm())
    return encode(message)


def manifest(**changed: Any) -> dict[str, Any]:
    return {
        "version": 1,
        "experiment": "scenario-1",
        "arm": "thesis",
        "profile": "ideal",
        "status": "completed",
        "reason": None,
        "revision": {"commit": "c0ffee", "dirty": False},
        "configuration": {"qos": 0, "states": "on-change", "streams": "px4-onboard"},
        "shaper": "none",
        "host": {"cores": 2, "machine": "x86_64", "python": "3.11.7"},
        "versions": {"mosquitto": "2.0.21"},
        "captures": [{"node": node, "captured": 3, "dropped": 0} for node in NODES],
        "topology": topology_of(NODES, LINKS),
    } | changed


def make_attempt(series: Series, number: int = 1, dropped: int = 0, **changed: Any) -> Attempt:
    """The arm command travels gs -> cloud -> fog1 -> uav1 in 3 x 1 ms; one state returns; one frame is lost on air."""
    attempt = new_attempt(series, "mqttxt", number)
    write_json(attempt.path / "manifest.json", manifest(**changed))
    ms = SECOND // 1000
    command = arm_command()
    hops = [
        (frame("gs", "cloud", publish("fog1/commands", command), 1), "gs", "cloud", T0),
        (frame("cloud", "fog1", publish("fog1/commands", command), 2, (1883, 5)), "cloud", "fog1", T0 + ms),
        (frame("fog1", "uav1", publish("drone1/commands", command), 3, (1883, 6)), "fog1", "uav1", T0 + 2 * ms),
    ]
    state = StampedState(Battery(90), 1234)
    relayed = StampedState(Battery(90), 1234, relay_stamp=5)
    up = encode_state(state, Encoding.CBOR), encode_state(relayed, Encoding.CBOR)
    later = T0 + 4 * SECOND
    hops += [
        (frame("uav1", "fog1", publish("drone1/state/battery", up[0]), 4), "uav1", "fog1", later),
        (frame("fog1", "cloud", publish(BATTERY, up[1]), 5), "fog1", "cloud", later + ms),
        (
            frame("cloud", "gs", publish(BATTERY, up[1]), 6, (1883, 7)),
            "cloud",
            "gs",
            later + 2 * ms,
        ),
    ]
    captures: dict[str, list[tuple[int, bytes]]] = {node: [] for node in NODES}
    for data, source, destination, t_ns in hops:
        captures[source].append((t_ns, data))
        captures[destination].append((t_ns + ms // 2, data))
    captures["uav1"].append((later + SECOND, frame("uav1", "fog1", b"", 7)))  # entered air:uav1:up and was lost
    captures["gs"].insert(0, (T0 - SECOND, frame("gs", "cloud", b"", 8)))  # before the mission
    captures["gs"].append((later, bytes(Ether() / ARP())))
    write_captures(attempt, captures, dropped)
    _write_events(attempt, later)
    return attempt


def called(t_ns: int, call: int, command: str, drone: int | None = None, fog: int | None = 1) -> dict[str, Any]:
    """A mission's event: a command to a drone, or with None to a whole fog."""
    return {"t_ns": t_ns, "event": "command", "call": call, "command": command, "fog": fog, "drone": drone}


def _write_events(attempt: Attempt, later: int) -> None:
    events = [
        {"t_ns": T0 - 1000, "event": "mission_start", "scenario": "scenario-1", "drones": [1]},
        called(T0 - 500, 1, "arm"),
        *(
            {
                **{"t_ns": T0 + after, "event": "outcome", "call": 1, "command": "arm", "fog": 1, "drone": 1},
                **{"id": "7:1", "word": word, "reason": None, "final": final},
            }
            for after, word, final in ((9_000_000, "accepted", False), (10_000_000, "completed", True))
        ),
        {"t_ns": later + 6 * SECOND, "event": "mission_end", "status": "completed", "reason": None},
    ]
    write_lines(attempt.path / "events.jsonl", events)
    flight = [
        {"t_ns": T0 + 3_000_000, "event": "armed"},
        {"t_ns": T0 + SECOND, "event": "position", "altitude_m": 5.0},
        {"t_ns": later + 5 * SECOND, "event": "disarmed"},
    ]
    write_lines(attempt.path / "sitl" / "uav1.jsonl", flight)
