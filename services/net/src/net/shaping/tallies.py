"""The kernel's counts, in the emulator's terms: drops by the queue, by random loss, and by a closed link.

A netem has only one number of drops. It is read whenever a link is closed or opened, so drops in between count by the
link's state at that time. Duplicates are the packets that left, wait or were dropped beyond those that entered netem.
The kernel does not count corrupted and reordered packets; these are null.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

VERSION = 1


@dataclass(frozen=True)
class Place:
    """Where a link's counters are: its device, mark, outgoing interface, and its queue's handle, if any."""

    device: str
    mark: str
    out: str
    queue: str | None


@dataclass
class Tally:
    """One link's counts so far."""

    place: Place
    closed: bool = False
    left: int = 0
    waiting: int = 0
    random: int = 0
    refused: int = 0
    """Packets dropped because the link was closed."""
    delayed: int = 0
    """Packets that reached the second stage."""
    queue_left: int = 0
    queue_drops: int = 0
    queue_waiting: int = 0

    def read_delay(self, shown: Mapping[str, Any]) -> None:
        """Read the second stage's netem, before the link is closed or opened."""
        drops = int(shown["drops"]) - self.random - self.refused
        if self.closed:
            self.refused += drops
        else:
            self.random += drops
        self.left, self.waiting = int(shown["packets"]), int(shown["qlen"])

    def read_queue(self, shown: Mapping[str, Any]) -> None:
        """Read the first stage's netem."""
        self.queue_left, self.queue_drops = int(shown["packets"]), int(shown["drops"])
        self.queue_waiting = int(shown["qlen"])

    def to_data(self) -> dict[str, int | None]:
        """The counts by the emulator's names."""
        entered = self.delayed if self.place.queue is None else self.queue_left + self.queue_drops + self.queue_waiting
        doubled = self.left + self.waiting + self.random + self.refused - self.delayed
        return {
            "entered": entered,
            "entered_bytes": None,
            "left": self.left,
            "queue": self.queue_drops,
            "random": self.random,
            "closed": self.refused,
            "refused": 0,
            "overload": 0,
            "duplicated": max(0, doubled),
            "corrupted": None,
            "reordered": None,
        }


class Tallies:
    """The tallies of all links."""

    def __init__(self, places: Mapping[str, Place]) -> None:
        self.links = {name: Tally(place) for name, place in places.items()}
        self._by_device = {tally.place.device: tally for tally in self.links.values()}
        self._by_queue = {tally.place.queue: tally for tally in self.links.values() if tally.place.queue is not None}
        self._outs = list(dict.fromkeys(tally.place.out for tally in self.links.values()))

    def shows(self) -> list[list[str]]:
        """The commands whose output `read` takes."""
        filters = [["tc", "filter", "show", "dev", out, "egress"] for out in self._outs]
        return [["tc", "qdisc", "show"], *filters]

    def read(self, shown: Sequence[Any]) -> None:
        """Read the output of the commands in `shows`, in the same order."""
        self.read_qdiscs(shown[0])
        by_place = {(tally.place.out, tally.place.mark): tally for tally in self.links.values()}
        for out, content in zip(self._outs, shown[1:], strict=True):
            for item in content:
                options = item.get("options", {})
                if "fw" in options and "actions" in options:
                    tally = by_place[out, options["fw"]["mark"]]
                    tally.delayed = int(options["actions"][0]["stats"]["packets"])

    def read_qdiscs(self, shown: Sequence[Mapping[str, Any]], device: str | None = None) -> None:
        """Read the netems of all devices, or of `device` if the output does not name it."""
        for item in shown:
            if item["kind"] != "netem":
                continue
            if item["handle"] in self._by_queue:
                self._by_queue[item["handle"]].read_queue(item)
            else:
                self._by_device[device or item["dev"]].read_delay(item)

    def by_link(self) -> dict[str, dict[str, int | None]]:
        """The counts of each link so far."""
        return {name: tally.to_data() for name, tally in self.links.items()}

    def report(self, profile: str, void: str | None, at_start: Mapping[str, Any] | None) -> dict[str, Any]:
        """The content of the counters file: totals, and their values when the links' clock began."""
        return {
            "version": VERSION,
            "shaper": "netem",
            "profile": profile,
            "links": self.by_link(),
            "at_start": at_start,
            "late_ms": None,
            "void": void,
        }
