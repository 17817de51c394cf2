"""Assigns captured frames to the links that they entered or left, and matches the frames at a link's two ends."""

from __future__ import annotations

import ipaddress

import numpy as np

from ...fly.pcap import Flags, Ints, Words
from ...plan.topology import Topology
from .headers import Headers

NOWHERE = -1


class Tree:
    """The topology's links in both directions. The nodes are a tree, so each has one next hop towards any other."""

    def __init__(self, topology: Topology) -> None:
        self.nodes = [node.name for node in topology.nodes]
        self.links = list(topology.ends)
        self._ends = list(topology.ends.values())
        addresses = np.array([int(ipaddress.IPv4Address(node.address)) for node in topology.nodes], dtype=np.int64)
        self._order = np.argsort(addresses)
        self._addresses = addresses[self._order]
        self._towards = {node: self._hops(node) for node in self.nodes}

    @property
    def drones(self) -> list[int]:
        """The numbers of the nodes called `uavN`."""
        numbers = (name.removeprefix("uav") for name in self.nodes if name.startswith("uav"))
        return [int(number) for number in numbers if number.isdecimal()]

    def receiver(self, link: str) -> str:
        """The node to which a directed link leads."""
        return self._ends[self.links.index(link)][1]

    def node_of(self, addresses: Ints) -> Ints:
        """The index in `nodes` of the node with each address; NOWHERE if no node has it."""
        if not self.nodes:
            return np.full(len(addresses), NOWHERE, dtype=np.int64)
        place = np.minimum(np.searchsorted(self._addresses, addresses), len(self.nodes) - 1)
        return np.where(self._addresses[place] == addresses, self._order[place], NOWHERE)

    def place(self, node: str, headers: Headers, mac: int | None) -> tuple[Ints, Flags]:
        """The link of each frame in a node's capture, and whether the frame entered it there (else it left it).

        `mac` is net's own address on that port: frames sent from it are on their way to the node. A frame from the
        node enters the link to the next hop towards its destination; a frame to it has left the link from the previous
        hop. Without `mac` IP addresses tell both apart, and only frames between neighbours get a link.
        """
        source, destination = self.node_of(headers.source), self.node_of(headers.destination)
        links = np.full(len(source), NOWHERE, dtype=np.int64)
        if node not in self._towards:
            return links, np.zeros(len(source), dtype=np.bool_)
        here = self.nodes.index(node)
        out, into = self._towards[node]
        if mac is None:
            departs, arrives = source == here, destination == here
            out, into = self._neighbours(node, out), self._neighbours(node, into)
        else:
            departs = headers.source_mac != mac
            arrives = ~departs
        known = (source != NOWHERE) & (destination != NOWHERE)
        links = np.where(departs & known, out[destination], np.where(arrives & known, into[source], NOWHERE))
        return links, departs

    def _hops(self, node: str) -> tuple[Ints, Ints]:
        """For each other node the link on which frames leave `node` towards it, and that on which its frames arrive."""
        out = np.full(len(self.nodes), NOWHERE, dtype=np.int64)
        into = out.copy()
        for number, (lower, upper) in enumerate(self._ends):
            if lower != node:
                continue
            for reached in self._behind(upper, node):
                out[self.nodes.index(reached)] = number
                into[self.nodes.index(reached)] = number ^ 1
        return out, into

    def _behind(self, start: str, without: str) -> set[str]:
        """The nodes that are reachable from `start` without passing `without`."""
        found, waiting = {start}, [start]
        while waiting:
            here = waiting.pop()
            fresh = {upper for lower, upper in self._ends if lower == here and upper != without} - found
            found |= fresh
            waiting += fresh
        return found

    def _neighbours(self, node: str, hops: Ints) -> Ints:
        """Keep only the hops to neighbours; the others become NOWHERE."""
        direct = {self.nodes.index(upper) for lower, upper in self._ends if lower == node}
        return np.array([hop if place in direct else NOWHERE for place, hop in enumerate(hops)], dtype=np.int64)


def match(entered_key: Words, entered_ns: Ints, left_key: Words, left_ns: Ints) -> Ints:
    """For each frame that entered a link its index among those that left; NOWHERE for a lost one.

    Both are sorted by time, and a key belongs to one link. The n-th frame with a key that left is the n-th that
    entered, unless fewer (or more) left than entered: then it is the last one that had entered before it left, and that
    no later one is, as with a repeated SYN-ACK of which several are on the link at once.
    """
    order, left_order = np.argsort(entered_key, kind="stable"), np.argsort(left_key, kind="stable")
    keys, left_keys = entered_key[order], left_key[left_order]
    first = np.searchsorted(left_keys, keys, side="left")
    count = np.searchsorted(left_keys, keys, side="right") - first
    begins = np.searchsorted(keys, keys, side="left")
    entered_count = np.searchsorted(keys, keys, side="right") - begins
    place = first + np.arange(len(keys)) - begins
    place[count == 0] = NOWHERE
    for at in np.flatnonzero((count < entered_count) & (count > 0) & (begins == np.arange(len(keys)))):
        times = left_ns[left_order[first[at] : first[at] + count[at]]]
        last = at + entered_count[at]
        came = entered_ns[order[at:last]]
        place[at:last] = NOWHERE
        free = len(came)
        for n in range(len(times) - 1, -1, -1):
            free = min(free, int(np.searchsorted(came, times[n], side="right"))) - 1
            if free < 0:
                break
            place[at + free] = first[at] + n
    for at in np.flatnonzero(count > entered_count):
        times = left_ns[left_order[first[at] : first[at] + count[at]]]
        until = entered_ns[order[at + 1]] if at + 1 < len(keys) and keys[at + 1] == keys[at] else None
        n = int(np.searchsorted(times, entered_ns[order[at]], side="left"))
        fits = n < len(times) and (until is None or times[n] < until)
        place[at] = first[at] + n if fits else NOWHERE
    found = np.full(len(keys), NOWHERE, dtype=np.int64)
    found[order] = np.where(place == NOWHERE, NOWHERE, left_order[np.maximum(place, 0)] if len(left_order) else NOWHERE)
    return found
