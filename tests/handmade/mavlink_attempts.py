"""A MAVLink attempt made by hand: drones that stream through a chain of routers, and a ground station that commands."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common

from testbed.fly.results import Attempt, Series, new_attempt, write_json
from tests.handmade.attempts import SECOND, T0, manifest, topology_of, write_captures, write_lines

MS = SECOND // 1000
HOP = MS
"""From entering a link to entering the next one; a frame leaves a link after half of it."""
ONBOARD_HZ = {
    **{"ATTITUDE": 100, "ATTITUDE_QUATERNION": 50, "GLOBAL_POSITION_INT": 50, "LOCAL_POSITION_NED": 30},
    **{"HIGHRES_IMU": 50, "ODOMETRY": 30, "SERVO_OUTPUT_RAW": 10, "RC_CHANNELS": 20, "GPS_RAW_INT": 10},
    **{"VFR_HUD": 10, "ALTITUDE": 10, "SYS_STATUS": 5, "EXTENDED_SYS_STATE": 5, "BATTERY_STATUS": 0.5},
    **{"HEARTBEAT": 1, "ATTITUDE_TARGET": 10, "POSITION_TARGET_LOCAL_NED": 10, "WIND_COV": 10, "TIMESYNC": 10},
    **{"POSITION_TARGET_GLOBAL_INT": 10, "NAV_CONTROLLER_OUTPUT": 10},
}
_UDP_HEAD = struct.Struct("!6s6sHBBHHHBBH4s4sHHHH")


def mac_of(node: str) -> str:
    """`net`'s own address on its port towards a node."""
    return f"02:00:00:00:ff:{sum(node.encode()) % 256:02x}"


def mac_bytes(text: str) -> bytes:
    return bytes.fromhex(text.replace(":", ""))


@dataclass
class Chain:
    """The nodes and their captures; `direct` ones forward IP instead of routing messages."""

    drones: tuple[int, ...] = (1,)
    direct: bool = False
    captures: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    identity: int = 0

    def __post_init__(self) -> None:
        self.captures |= {name: [] for name in self.nodes}

    @property
    def nodes(self) -> dict[str, str]:
        fogs = {f"fog{fog}": f"198.18.{10 + fog}.3" for fog in sorted({self.fog_of(drone) for drone in self.drones})}
        uavs = {f"uav{drone}": f"198.18.{20 + drone}.3" for drone in self.drones}
        return {"gs": "198.18.0.3", "cloud": "198.18.1.3"} | fogs | uavs

    @property
    def links(self) -> list[tuple[str, str, str]]:
        fogs = sorted({self.fog_of(drone) for drone in self.drones})
        return [
            ("wan:gs", "gs", "cloud"),
            *((f"backhaul:fog{fog}", f"fog{fog}", "cloud") for fog in fogs),
            *((f"air:uav{drone}", f"uav{drone}", f"fog{self.fog_of(drone)}") for drone in self.drones),
        ]

    @staticmethod
    def fog_of(drone: int) -> int:
        return 1 if drone <= 3 else 2

    def way(self, drone: int, up: bool) -> list[str]:
        nodes = [f"uav{drone}", f"fog{self.fog_of(drone)}", "cloud", "gs"]
        return nodes if up else nodes[::-1]

    def send(
        self,
        t_ns: int,
        body: bytes,
        drone: int,
        up: bool,
        since: str | None = None,
        until: str | None = None,
        lost_on: str | None = None,
    ) -> None:
        """Send a datagram along the chain, from the router `since` on; that at `until` drops it, the link into
        `lost_on` loses it."""
        way = self.way(drone, up)
        way = way[way.index(since) :] if since is not None else way
        port = 14540 + drone
        for number, (here, there) in enumerate(itertools.pairwise(way)):
            self.identity = self.identity % 65535 + 1
            ends = (way[0], way[-1]) if self.direct else (here, there)
            ttl = 64 - number if self.direct else 64
            identity = 7 if self.direct else self.identity
            data = [
                udp_frame(
                    self.nodes[ends[0]],
                    self.nodes[ends[1]],
                    body,
                    identity,
                    ports=(port, port),
                    ttl=ttl - at,
                    macs=macs,
                )
                for at, macs in enumerate(
                    ((f"02:00:00:00:00:{here[-1].encode().hex()}", mac_of(here)), (mac_of(there), "02:00:00:00:00:01"))
                )
            ]
            self.captures[here].append((t_ns + number * HOP, data[0]))
            if there == lost_on:
                return
            self.captures[there].append((t_ns + number * HOP + HOP // 2, data[1]))
            if there == until:
                return


def udp_frame(
    source: str,
    destination: str,
    body: bytes,
    identity: int,
    ports: tuple[int, int] = (14541, 14541),
    ttl: int = 64,
    macs: tuple[str, str] = ("02:00:00:00:00:01", "02:00:00:00:00:02"),
) -> bytes:
    """14 + 20 + 8 bytes of headers, then the body."""
    addresses = [bytes(int(part) for part in address.split(".")) for address in (source, destination)]
    length = 8 + len(body)
    header_checksum = ttl  # another one at every hop
    head = _UDP_HEAD.pack(
        *(mac_bytes(macs[1]), mac_bytes(macs[0]), 0x0800, 0x45, 0, 20 + length, identity, 0x4000, ttl, 17),
        *(header_checksum, *addresses, *ports, length, 0),
    )
    return head + body


def sender(system: int, component: int = 1) -> common.MAVLink:
    """A codec that packs messages of one system; `packed` counts its sequence numbers."""
    return common.MAVLink(None, srcSystem=system, srcComponent=component)


def packed(link: common.MAVLink, message: Any, version_1: bool = False) -> bytes:
    data: bytes = message.pack(link, force_mavlink1=version_1)
    link.seq = (link.seq + 1) % 256
    return data


def long_command(command: int, drone: int, *params: float) -> Any:
    return common.MAVLink_command_long_message(drone, 1, command, 0, *params, *[0.0] * (7 - len(params)))


def armed(drones: tuple[int, ...] = (1,), direct: bool = False) -> Chain:
    """A chain over which the ground station arms drone 1 at T0."""
    chain = Chain(drones, direct)
    chain.send(T0, packed(sender(245, 190), long_command(400, 1, 1.0)), 1, up=False)
    return chain


def mission(chain: Chain, calls: list[dict[str, Any]], end_s: float = 10.0) -> list[dict[str, Any]]:
    """The events of a completed mission in which these calls were made; it ends so long after T0."""
    start = {"t_ns": T0 - SECOND, "event": "mission_start", "scenario": "scenario-1", "drones": list(chain.drones)}
    end = {"t_ns": T0 + int(end_s * SECOND), "event": "mission_end", "status": "completed", "reason": None}
    return [start, *calls, end]


def stream_message(name: str, t_ms: int) -> Any:
    """A message of a stream, with a stamp where it has one and 1 everywhere else."""
    kind = next(known for known in common.mavlink_map.values() if known.msgname == name)
    values: list[Any] = []
    for field_name, type_name in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        lanes = kind.array_lengths[kind.ordered_fieldnames.index(field_name)]
        stamp = t_ms if field_name.startswith("time_") else t_ms * 1000 if field_name == "ts1" else 1
        values.append(b"1" if type_name == "char" else [1] * lanes if lanes else stamp)
    return kind(*values)


def streams(seconds: float, rates_hz: dict[str, float]) -> Iterator[tuple[int, str]]:
    """When (nanoseconds) a drone sends which message, one kind after the other."""
    for name, rate in rates_hz.items():
        for number in range(round(seconds * rate)):
            yield round((number + 0.5) / rate * SECOND), name


def fill_streams(chain: Chain, seconds: float, rates_hz: dict[str, float]) -> int:
    """Let every drone stream from T0 on; returns how many messages each sends."""
    times = sorted(streams(seconds, rates_hz))
    for drone in chain.drones:
        link = sender(drone)
        for after, name in times:
            data = packed(link, stream_message(name, after // MS))
            chain.send(T0 + after + drone * 1000, data, drone, up=True)
    return len(times)


def make_mavlink_attempt(
    series: Series,
    number: int,
    chain: Chain,
    events: list[dict[str, Any]],
    disarmed_s: float,
    mac: bool = True,
    routers: str = "per-uav",
    **changed: Any,
) -> Attempt:
    """Make the attempt's folder with the chain's captures; every drone disarms `disarmed_s` after T0."""
    attempt = new_attempt(series, "mavlink", number)
    topology, cpu_s = topology_of(chain.nodes, chain.links), {"gs": 1.5, "router-gs": 0.25}
    write_json(
        attempt.path / "manifest.json",
        manifest(protocol="mavlink", topology=topology, cpu_s=cpu_s, configuration={"chain": routers}, **changed),
    )
    write_captures(attempt, chain.captures, macs={node: mac_of(node) for node in chain.nodes} if mac else None)
    write_lines(attempt.path / "events.jsonl", events)
    flight = [{"t_ns": T0 + 1, "event": "armed"}, {"t_ns": T0 + int(disarmed_s * SECOND), "event": "disarmed"}]
    for drone in chain.drones:
        write_lines(attempt.path / "sitl" / f"uav{drone}.jsonl", flight)
    return attempt
