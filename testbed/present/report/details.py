"""The detailed tables of one attempt per protocol: links, layers, message mix, routers, CPU seconds, outcomes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any, TypedDict

from ...numbers.attempt_entry import (
    AttemptEntry,
    DelaysEntry,
    LinkEntry,
    MavlinkMessage,
    MavlinkStream,
    OutcomeEntry,
    Router,
    SizeEntry,
)
from ...plan.topology import by_number, place_of_link
from . import thesis

Shown = dict[str, AttemptEntry]
"""By protocol the entry in `metrics.json` of the attempt that is shown in detail."""

LAYERS = (
    ("payload", ("payload",)),
    ("MQTT or MAVLink framing", ("mqtt", "mavlink")),
    ("TLS", ("tls",)),
    ("TCP or UDP", ("tcp", "udp")),
    ("IP", ("ip",)),
    ("Ethernet", ("ethernet",)),
)
_NO_COUNT: LinkEntry = {"packets": 0, "bytes": 0, "lost": 0}
_NODES = ("gs", "cloud", "fog", "uav", "sensor")
_IDLE = "nodes that only hold an address"
_ROLES = (
    ("ground station", ("gs",)),
    ("broker", ("broker",)),
    ("activators", ("activator",)),
    ("UAV clients", ("client",)),
    ("routers", ("router-",)),
    ("plain brokers beside it", ("bridge-",)),
    ("autopilots", ("sitl",)),
    ("sensors", ("meter",)),
    ("network and captures", ("net",)),
    (_IDLE, ("cloud", "fog", "uav", "sensor")),
)
_NOT_THE_PROTOCOLS = ("autopilots", "sensors", "network and captures")


class StreamShare(MavlinkStream):
    """A stream with its share of the bytes, and the width of its bar, both in percent."""

    percent: float
    width: float


class Mix(TypedDict):
    """The messages of the MAVLink side, with sums."""

    streams: list[StreamShare]
    count: int
    rate_hz: float
    bytes: int
    commands: list[MavlinkMessage]
    own_heartbeats: int


@dataclass(frozen=True)
class RoleCpu:
    """The CPU seconds of the containers with one role: their sum and each one's own, by protocol."""

    name: str
    sums: dict[str, float]
    containers: dict[str, list[tuple[str, float]]]

    @property
    def idle(self) -> bool:
        return self.name == _IDLE


@dataclass(frozen=True)
class Command:
    """A command on one side: its calls, one-way delays in milliseconds, frames per call."""

    calls: int
    copies: int
    least_ms: float | None
    median_ms: float | None
    most_ms: float | None
    frames: float | None


def links_of(shown: Shown) -> list[tuple[str, dict[str, tuple[LinkEntry, LinkEntry]]]]:
    """Each link with its counts up and down by protocol: wan, backhaul, air, and the sum of all links last."""
    names = sorted(
        {name.rsplit(":", 1)[0] for attempt in shown.values() for name in attempt["links"]},
        key=place_of_link,
    )
    table = [
        (name, {p: (_count(a, f"{name}:up"), _count(a, f"{name}:down")) for p, a in shown.items()}) for name in names
    ]
    if len(table) > 1:
        sums = {p: (_sum(row[p][0] for _, row in table), _sum(row[p][1] for _, row in table)) for p in shown}
        table.append(("all links", sums))
    return table


def by_layer(layers: dict[str, int]) -> dict[str, int]:
    """Bytes by the layers that both sides have, and `other` bytes."""
    counted = {name: sum(layers.get(part, 0) for part in inner) for name, inner in LAYERS}
    return {**counted, "other": sum(layers.values()) - sum(counted.values())}


def mix_of(attempt: AttemptEntry) -> Mix | None:
    """The MAVLink side's streams, largest first, each with its share; commands; sums. None for another side."""
    mavlink = attempt["mavlink"]
    if not mavlink:
        return None
    streams = sorted(mavlink["streams"], key=lambda stream: (-stream["bytes"], stream["name"]))
    total = sum(stream["bytes"] for stream in streams)
    most = max((stream["bytes"] for stream in streams), default=0)
    return {
        "streams": [
            {**stream, "percent": 100 * stream["bytes"] / total, "width": 100 * stream["bytes"] / most}
            for stream in streams
            if total
        ],
        "count": sum(stream["count"] for stream in streams),
        "rate_hz": sum(stream["rate_hz"] for stream in streams),
        "bytes": total,
        "commands": sorted(mavlink["commands"], key=lambda sent: (-sent["count"], sent["name"])),
        "own_heartbeats": mavlink["own_heartbeats"],
    }


def routers_of(attempt: AttemptEntry) -> list[tuple[str, dict[str, Router]]]:
    """By node and direction the messages that its routers received, forwarded and dropped; ground station first."""
    entries = attempt["mavlink"]["routers"] if attempt["mavlink"] else []
    nodes = sorted({entry["node"] for entry in entries}, key=lambda node: (_place(node, _NODES), by_number(node)))
    return [(node, {entry["way"]: entry for entry in entries if entry["node"] == node}) for node in nodes]


def roles_of(cpu: Mapping[str, Mapping[str, float]]) -> list[RoleCpu]:
    """Group the CPU seconds by protocol and container into roles."""
    by_protocol = {protocol: _by_role(seconds) for protocol, seconds in cpu.items()}
    names = [name for name, _ in _ROLES] + ["other"]
    return [
        RoleCpu(
            name,
            {p: sum(seconds for _, seconds in found[name]) for p, found in by_protocol.items() if name in found},
            {p: found[name] for p, found in by_protocol.items() if name in found},
        )
        for name in names
        if any(name in found for found in by_protocol.values())
    ]


def protocols_own(roles: list[RoleCpu]) -> dict[str, float]:
    """CPU seconds by protocol, without the containers that both sides need: autopilots, sensors, network, captures."""
    sums: dict[str, float] = {}
    for role in roles:
        if role.name not in _NOT_THE_PROTOCOLS:
            for protocol, seconds in role.sums.items():
                sums[protocol] = sums.get(protocol, 0.0) + seconds
    return sums


def command_of(attempt: AttemptEntry, events: list[dict[str, Any]], name: str) -> Command:
    """The figures of a command on one side."""
    delays = sorted(attempt["delay_ms"].get(name, []))
    calls = sum(event["event"] == "command" and event["command"] == name for event in events)
    frames = attempt["frames_per_call"].get(name)
    if not delays:
        return Command(calls, 0, None, None, None, frames)
    return Command(calls, len(delays), delays[0], median(delays), delays[-1], frames)


def outcomes_of(attempt: AttemptEntry, commands: list[str]) -> dict[str, list[OutcomeEntry | None]]:
    """By drone the outcome of each of `commands`, in their order; None where a drone has none."""
    found = {}
    for drone, entries in attempt["outcomes"].items():
        by_command = {entry["command"]: entry for entry in entries}
        found[drone] = [by_command.get(command) for command in commands]
    return found


@dataclass(frozen=True)
class LinkFigure:
    """A figure of a directed link, configured and measured, or why it was not measured; None: unlimited, unknown."""

    configured: float | None
    measured: float | None
    note: str | None


FIGURES = ("delay_ms", "jitter_ms", "rate_bps", "loss")


def figures_of_link(entry: Mapping[str, Any]) -> dict[str, LinkFigure]:
    """A directed link's figures by name, from its entry in `links_measured`; unknown ones are left out."""
    return {
        figure: LinkFigure(one.get("configured"), one.get("measured"), one.get("note"))
        for figure in FIGURES
        if isinstance(one := entry.get(figure), dict)
    }


def measured_links(shown: Shown) -> list[tuple[str, dict[str, dict[str, LinkFigure]]]]:
    """Each directed link with its figures by protocol and name; empty if nothing was measured."""
    names = {name for attempt in shown.values() for name in attempt["links_measured"]}
    return [
        (name, {p: figures_of_link(attempt["links_measured"].get(name, {})) for p, attempt in shown.items()})
        for name in sorted(names, key=place_of_link)
    ]


def sizes_of(shown: Shown) -> list[tuple[str, dict[str, SizeEntry], dict[str, int]]]:
    """Each kind of message with its frame sizes by protocol, and the sizes printed in the thesis."""
    printed = thesis.packet_sizes()
    kinds = {p: attempt["message_sizes"] for p, attempt in shown.items()}
    names = {name for by in kinds.values() for name in by}
    known = [name for name in printed if name in names]
    order = known + sorted(names - set(known))
    return [(name, {p: by[name] for p, by in kinds.items() if name in by}, printed.get(name, {})) for name in order]


def states_of(shown: Shown) -> list[tuple[str, dict[str, DelaysEntry]]]:
    """Each state with its summary of delays by protocol."""
    kinds = {p: attempt["state_delay_ms"] for p, attempt in shown.items()}
    names = sorted({name for by in kinds.values() for name in by})
    return [(name, {p: by[name] for p, by in kinds.items() if name in by}) for name in names]


def _by_role(seconds: Mapping[str, float]) -> dict[str, list[tuple[str, float]]]:
    found: dict[str, list[tuple[str, float]]] = {}
    for service in sorted(seconds, key=lambda name: (_place(name.removeprefix("router-"), _NODES), by_number(name))):
        matching = [role for role, starts in _ROLES if service.startswith(starts)]
        found.setdefault(matching[-1] if matching else "other", []).append((service, seconds[service]))
    return found


def _count(attempt: AttemptEntry, name: str) -> LinkEntry:
    return attempt["links"].get(name, _NO_COUNT)


def _sum(links: Iterable[LinkEntry]) -> LinkEntry:
    packets, bytes_, lost = 0, 0, 0
    for link in links:
        packets, bytes_, lost = packets + link["packets"], bytes_ + link["bytes"], lost + link["lost"]
    return {"packets": packets, "bytes": bytes_, "lost": lost}


def _place(name: str, order: tuple[str, ...]) -> int:
    return next((place for place, start in enumerate(order) if name.startswith(start)), len(order))
