"""What a side of a cell lost: of its completed attempts, or where there are none of its failed ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...numbers import words
from ...numbers.metrics.statistics import loss_of
from ..report.comparison import completed
from .cells import SIDES, Cell

KINDS = ("commands", "states", "frames")
FAILED = "†"
"""Marks a loss that is of failed attempts, until they gave up."""


@dataclass(frozen=True)
class Loss:
    """`lost` of `known`, which is what was sent but for what is still open."""

    lost: int
    known: int

    def __add__(self, other: Loss) -> Loss:
        return Loss(self.lost + other.lost, self.known + other.known)

    def __str__(self) -> str:
        """'23 %', and where nothing was lost its 95 % bound: '0 (< 0.44 %)', or of how few: '0 of 2'."""
        told = loss_of(self.known, self.lost)
        if told["share"] is None:
            return words.NOTHING
        if told["below"] == 1.0:
            return f"0 of {self.known}"
        return words.share(told["share"]) if self.lost else f"0 (< {words.share(told['below'])})"


def loss(attempts: list[dict[str, Any]], kind: str) -> Loss:
    """Of all attempts together: commands, states, or frames on the links."""
    if kind == "frames":
        lost = sum(link["lost"] for attempt in attempts for link in attempt["links"].values())
        return Loss(lost, sum(attempt["packets"] for attempt in attempts))
    counts = [count for attempt in attempts for count in attempt["messages"][kind].values()]
    return Loss(sum(one["lost"] for one in counts), sum(one["sent"] - one["open"] for one in counts))


def both_sides(cell: Cell, kind: str) -> list[str]:
    """'0 (< 0.44 %)' and '23 %'; with FAILED where a side completed no attempt."""
    said = []
    for protocol in SIDES:
        side = cell.metrics["protocols"].get(protocol, {"attempts": []})
        done = completed(side)
        found = str(loss(done or side["attempts"], kind))
        said.append(found if done or found == words.NOTHING else f"{found}{FAILED}")
    return said
