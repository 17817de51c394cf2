"""Both protocols of a series compared: their quantities, the attempts that count, and those shown in detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...numbers import quantities, words
from ...numbers.attempt_entry import AttemptEntry
from ...numbers.observed import observe
from ...numbers.quantities import QuantityRow
from ...numbers.written import Metrics, SideEntry, VoidEntry
from ...plan import wording


def rows(metrics: Metrics) -> dict[str, QuantityRow]:
    """The compared rows by the quantity's key: completion, traffic, time, losses, delay, frames per call."""
    return quantities.rows(observe(metrics["protocols"]))


def completed(side: SideEntry) -> list[AttemptEntry]:
    return [attempt for attempt in side["attempts"] if attempt["status"] == "completed"]


def fleet_size(attempt: AttemptEntry) -> tuple[int, int]:
    """The numbers of fogs and drones in a completed attempt, by its links and outcomes."""
    fogs = {link.split(":")[1] for link in attempt["links"] if link.startswith("backhaul:")}
    return len(fogs), len(attempt["outcomes"])


@dataclass(frozen=True)
class Completion:
    """The attempts of a protocol by how they ended; failed and void ones as pairs of a reason and its attempts.

    `flown` is without void attempts.
    """

    flown: int
    completed: int
    failed: tuple[tuple[str, tuple[int, ...]], ...]
    void: tuple[tuple[str, tuple[int, ...]], ...]

    @staticmethod
    def count(reasons: tuple[tuple[str, tuple[int, ...]], ...]) -> int:
        return sum(len(attempts) for _, attempts in reasons)


def completion(metrics: Metrics) -> dict[str, Completion]:
    """The completion by protocol. Void attempts are not in `flown`, which has those that count."""
    found = {}
    for protocol, side in words.sides(metrics):
        failed = [a for a in side["attempts"] if a["status"] != "completed"]
        flown = len(side["attempts"])
        found[protocol] = Completion(flown, len(completed(side)), _by_reason(failed), _by_reason(side["void"]))
    return found


def _by_reason(attempts: Sequence[AttemptEntry | VoidEntry]) -> tuple[tuple[str, tuple[int, ...]], ...]:
    found: dict[str, list[int]] = {}
    for attempt in attempts:
        found.setdefault(wording.first_line(attempt["reason"]), []).append(attempt["attempt"])
    return tuple((reason, tuple(numbers)) for reason, numbers in found.items())


def shown(metrics: Metrics) -> dict[str, AttemptEntry]:
    """The attempt of each protocol that is shown in detail: the first number completed by all, else the first
    completed one, else the first. A protocol without attempts that count is left out."""
    numbers = [{attempt["attempt"] for attempt in completed(side)} for _, side in words.sides(metrics)]
    shared = set.intersection(*numbers) if numbers else set()
    chosen = {}
    for protocol, side in words.sides(metrics):
        candidates = [a for a in completed(side) if not shared or a["attempt"] in shared] or side["attempts"]
        if candidates:
            chosen[protocol] = candidates[0]
    return chosen
