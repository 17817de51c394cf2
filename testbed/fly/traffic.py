"""The current traffic of each link, from the captures while they are written."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from ipaddress import IPv4Address
from pathlib import Path

import numpy as np

from ..errors import ResultsError
from ..plan.topology import Link, Topology
from .pcap import Bytes, CaptureTail, Ints, big_endian, windows

_HEAD = 42
"""Bytes of Ethernet's header, and of the part of IPv4's or ARP's that is read."""
_IPV4, _ARP = 0x0800, 0x0806
_SENDER = {_IPV4: 26, _ARP: 28}
"""The offset of the sender's IP address, by EtherType."""


@dataclass(frozen=True)
class Carried:
    """The traffic of one direction of a link, per second."""

    packets_per_s: float = 0.0
    bytes_per_s: float = 0.0


class Traffic:
    """Frames and bytes of every directed link since the last look; bytes are Ethernet frames without FCS.

    A link is counted in the capture of its lower node, without that node's frames to and from nodes below it, which
    cross another link.

    Parameters:
        folder: the folder with each node's capture, NODE.pcap.
        topology: nodes and links.
        clock: returns seconds.
    """

    def __init__(self, folder: Path, topology: Topology, clock: Callable[[], float] = time.monotonic) -> None:
        address = {node.name: int(IPv4Address(node.address)) for node in topology.nodes}
        self._clock = clock
        self._looked_s = clock()
        self._places = [
            _Place(
                link,
                CaptureTail(folder / f"{link.lower}.pcap"),
                address[link.lower],
                np.array([address[below.lower] for below in topology.links if below.upper == link.lower], np.int64),
            )
            for link in topology.links
        ]

    def look(self) -> Mapping[str, Carried]:
        """The traffic by directed link, as `air:uav1:up`; links whose capture cannot be read are left out."""
        now_s = self._clock()
        took_s, self._looked_s = max(now_s - self._looked_s, 1e-3), now_s
        found = {}
        for place in self._places:
            try:
                counts = place.count()
            except ResultsError:
                continue
            for way, (frames, size) in counts.items():
                found[f"{place.link.name}:{way}"] = Carried(frames / took_s, size / took_s)
        return found


@dataclass
class _Place:
    """The place where a link is counted: the capture of its lower node."""

    link: Link
    tail: CaptureTail
    own: int
    below: Ints
    mac: int | None = None
    """The node's MAC address, once a frame has shown it."""

    def count(self) -> dict[str, tuple[int, int]]:
        """Count the new frames and their bytes, by direction."""
        capture = self.tail.more()
        whole = capture.lengths >= _HEAD
        heads = windows(capture.data, _HEAD, capture.starts[whole])
        sizes = capture.sizes[whole]
        kind, source = big_endian(heads, 12, 2), big_endian(heads, 6, 6)
        if self.mac is None:
            self.mac = self._learned(heads, kind, source)
        if self.mac is None:
            return {"up": (0, 0), "down": (0, 0)}
        crossing, is_own = kind == _IPV4, source == self.mac
        ways = {
            "up": crossing & is_own & ~np.isin(big_endian(heads, 30, 4), self.below),
            "down": crossing & ~is_own & ~np.isin(big_endian(heads, 26, 4), self.below),
        }
        return {way: (int(frames.sum()), int(sizes[frames].sum())) for way, frames in ways.items()}

    def _learned(self, heads: Bytes, kind: Ints, source: Ints) -> int | None:
        for carries, at in _SENDER.items():
            shown = source[(kind == carries) & (big_endian(heads, at, 4) == self.own)]
            if len(shown):
                return int(shown[0])
        return None
