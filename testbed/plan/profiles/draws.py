"""Random draws: seeds, phases and bursts, as functions of a seed and of time, never of the traffic.

Both protocols of an attempt meet the same links, however many packets each of them sends.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from random import Random

from .reading import EventRule

_SEED_BYTES = 6
"""48 bits, which every reader of JSON represents exactly."""


def seed_of(*parts: str | int) -> int:
    """A seed from the parts; the same parts in the same order always give the same seed."""
    digest = hashlib.sha256("/".join(map(str, parts)).encode()).digest()
    return int.from_bytes(digest[:_SEED_BYTES], "big")


def plan_seed(experiment: str, attempt: int) -> int:
    """The seed of an attempt; it does not depend on protocol and profile."""
    return seed_of(experiment, attempt)


def link_seed(seed: int, link: str, use: str = "") -> int:
    """The seed of one link in the plan with `seed`; `use` separates draws that must not depend on each other."""
    return seed_of(seed, link, use)


def occurrences(rule: EventRule, draw: Random, length_us: int) -> Iterator[tuple[int, int]]:
    """The start and duration of a rule's events, in microseconds, cut off at the end of the plan.

    Periodic events start with a phase drawn uniformly from their period. The duration of bursts is uniform between
    shortest and longest; the gaps between them are exponential, with the mean that gives bursts their share of time.
    """
    for at_us, for_us in _unbounded(rule, draw, length_us):
        if at_us >= length_us:
            return
        yield at_us, min(for_us, length_us - at_us)


def _unbounded(rule: EventRule, draw: Random, length_us: int) -> Iterator[tuple[int, int]]:
    if rule.at_us is not None:
        yield rule.at_us, length_us if rule.for_us is None else rule.for_us
        return
    if rule.every_us is not None and rule.for_us is not None:
        at_us = int(draw.random() * rule.every_us)
        while True:
            yield at_us, rule.for_us
            at_us += rule.every_us
    share = rule.share or 0.0
    gap_us = (rule.shortest_us + rule.longest_us) / 2 * (1 - share) / share
    at_us = 0
    while True:
        at_us += max(1, round(-gap_us * math.log(1 - draw.random())))
        for_us = rule.shortest_us + int(draw.random() * (rule.longest_us - rule.shortest_us + 1))
        yield at_us, for_us
        at_us += for_us
