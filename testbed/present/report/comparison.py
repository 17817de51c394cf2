"""Both protocols of a series beside each other: their quantities, which attempts count, and which one is shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...numbers import quantities, words
from ...numbers.attempt_entry import AttemptEntry
from ...numbers.observed import observe
from ...numbers.quantities import Row
from ...numbers.written import Metrics, SideEntry, VoidEntry
from ...plan import wording


def rows(metrics: Metrics) -> dict[str, Row]:
    """Completion first, then traffic, time, losses, delay and frames per call; by the quantity's key."""
    return quantities.rows(observe(metrics["protocols"]))


def completed(side: SideEntry) -> list[AttemptEntry]:
    return [attempt for attempt in side["attempts"] if attempt["status"] == "completed"]


def fleet_size(attempt: AttemptEntry) -> tuple[int, int]:
    """How many fogs and drones a completed attempt had, by what was measured."""
    fogs = {link.split(":")[1] for link in attempt["links"] if link.startswith("backhaul:")}
    return len(fogs), len(attempt["outcomes"])


@dataclass(frozen=True)
class Completion:
    """How many attempts of a protocol were flown and what became of them; a reason and its attempts each."""

    flown: int
    completed: int
    failed: tuple[tuple[str, tuple[int, ...]], ...]
    void: tuple[tuple[str, tuple[int, ...]], ...]

    @staticmethod
    def count(reasons: tuple[tuple[str, tuple[int, ...]], ...]) -> int:
        return sum(len(attempts) for _, attempts in reasons)


def completion(metrics: Metrics) -> dict[str, Completion]:
    """By protocol. Void attempts are flown too, but they are not among those that count."""
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
    """Which attempt of each protocol is shown in detail: the first number completed by all, else the first
    completed one, else the first. A protocol without any is left out."""
    numbers = [{attempt["attempt"] for attempt in completed(side)} for _, side in words.sides(metrics)]
    shared = set.intersection(*numbers) if numbers else set()
    chosen = {}
    for protocol, side in words.sides(metrics):
        candidates = [a for a in completed(side) if not shared or a["attempt"] in shared] or side["attempts"]
        if candidates:
            chosen[protocol] = candidates[0]
    return chosen
