"""A cell's bytes for each side: per second, by purpose and by layer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from ...numbers import words
from ...numbers.packets.purposes import PURPOSES
from ...numbers.quantities import COUNTED_BYTES_PER_S
from ...plan import wording
from .cells import SIDES, Cell
from .numbers import attempts_of

LAYERS = {
    "payload": ("payload",),
    "MQTT or MAVLink": ("mqtt", "mavlink"),
    "TLS": ("tls",),
    "TCP or UDP": ("tcp", "udp"),
    "IP": ("ip",),
    "Ethernet": ("ethernet",),
}
"""Headings, each with the layer's names in metrics.json on either side."""
READING = (
    "Bytes a second: the median of all attempts that count, failed ones too, over all links. Shares are of all their "
    "bytes together, by purpose and then by layer; a frame with several messages is shared out among them by length."
)


@dataclass(frozen=True)
class Bytes:
    """One side of a cell; the shares of its bytes add up to 1 over the purposes, and over the layers."""

    arm: str
    protocol: str
    attempts: str
    a_second: str
    purposes: dict[str, float]
    layers: dict[str, float]


def bytes_of(cell: Cell) -> list[Bytes]:
    """The bytes of each side; a side without bytes is left out."""
    found = []
    for protocol in SIDES:
        a_second = COUNTED_BYTES_PER_S.figure(cell.sides[protocol])
        if not a_second.value:
            continue
        purposes, layers = Counter[str](), Counter[str]()
        for attempt in cell.sides[protocol].attempts:
            purposes.update(attempt.purposes)
            layers.update(attempt.layers)
        by_layer = {name: sum(layers[one] for one in ones) for name, ones in LAYERS.items()}
        found.append(
            Bytes(cell.arm, protocol, attempts_of(cell, protocol), a_second.text, _shares(purposes), _shares(by_layer))
        )
    return found


def table(found: list[Bytes]) -> tuple[list[str], list[list[str]]]:
    """Headings and rows; purposes and layers without bytes on any side have no column."""
    used = [name for name in PURPOSES if any(one.purposes.get(name) for one in found)]
    layers = [name for name in LAYERS if any(one.layers[name] for one in found)]
    headings = ["arm", "", "completed", "bytes a second", *used, *layers]
    rows = [
        [
            one.arm,
            wording.name_of(one.protocol),
            one.attempts,
            one.a_second,
            *(_share(one.purposes.get(name)) for name in used),
            *(_share(one.layers[name]) for name in layers),
        ]
        for one in found
    ]
    return headings, rows


def _shares(counts: Mapping[str, int]) -> dict[str, float]:
    total = sum(counts.values())
    return {name: count / total if total else 0.0 for name, count in counts.items()}


def _share(value: float | None) -> str:
    return words.share(value) if value else words.NOTHING
