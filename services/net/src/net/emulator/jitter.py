"""Jitter as a function of (seed, time): the link is the same for senders of much and of little traffic.

netem draws a delay for every packet. If order is kept, a packet then waits for the slowest one before it, so a busy
flow has more delay than a quiet one on the same link. Here the delay is a random process over time, with netem's
distribution at every instant:

- order kept: two independent normal values, one at each end of a slot of several jitters, are blended along a quarter
  circle, so that the value in between is exactly standard normal too. It then falls slower than time passes (except
  in the steepest tail, 0.3 % of the time), so no packet has to wait for the one before.
- reordering: a separate value for every `FAST_SLOT_NS`, that is for every packet on all but the fastest links.

The distributions are those of iproute2's tables (netem/normal.c, netem/pareto.c) and of netem's uniform (plus or minus
the jitter), cut off at four times the jitter.
"""

from __future__ import annotations

import hashlib
import math
import random
from collections.abc import Callable
from functools import cache
from statistics import NormalDist

from ..link_plan import SLOT_JITTERS

TABLE_SIZE = 1 << 14
_MASK = TABLE_SIZE - 1
CUT = 4.0
"""netem's tables have 16-bit values, 8192 per unit, and so end at 4."""
FAST_SLOT_NS = 50_000
PARETO_SHAPE = 3.0

Jitter = Callable[[int], int]
"""From time in ns to the deviation from the delay in ns."""


def quantile(distribution: str, share: float) -> float:
    """The value below which `share` (between 0 and 1, both excluded) of the deviations lie, in units of the jitter."""
    if distribution == "uniform":
        return 2.0 * share - 1.0
    if distribution == "pareto":
        return min(CUT, (math.pow(1.0 - share, -1.0 / PARETO_SHAPE) - 1.5) * 4.0 / 3.0)
    return max(-CUT, min(CUT, NormalDist().inv_cdf(share)))


def make_jitter(distribution: str, jitter_ns: int, reordering: bool, seed: int, name: str) -> Jitter:
    """The jitter of the link `name`; the same for the same arguments."""
    if jitter_ns == 0:
        return _none
    if reordering:
        return _fast(distribution, jitter_ns, seed, name)
    return _smooth(distribution, jitter_ns, seed, name)


def generator(seed: int, name: str, purpose: str) -> random.Random:
    """A separate generator for each purpose of each link."""
    digest = hashlib.sha256(f"{seed}/{name}/{purpose}".encode()).digest()
    return random.Random(int.from_bytes(digest[:16], "big"))


def _none(_: int) -> int:
    return 0


def _fast(distribution: str, jitter_ns: int, seed: int, name: str) -> Jitter:
    table = _shuffled(distribution, seed, name)

    def at(time_ns: int) -> int:
        return int(table[_place(time_ns // FAST_SLOT_NS)] * jitter_ns)

    return at


def _smooth(distribution: str, jitter_ns: int, seed: int, name: str) -> Jitter:
    table = _shuffled("normal", seed, name)
    slot_ns = SLOT_JITTERS[distribution] * jitter_ns
    quarter = math.pi / 2 / slot_ns
    erf, cos, sin, half = math.erf, math.cos, math.sin, math.sqrt(0.5)

    def normal(time_ns: int) -> float:
        slot, rest = divmod(time_ns, slot_ns)
        angle = rest * quarter
        return cos(angle) * table[_place(slot)] + sin(angle) * table[_place(slot + 1)]

    def as_normal(time_ns: int) -> int:
        return int(max(-CUT, min(CUT, normal(time_ns))) * jitter_ns)

    def as_uniform(time_ns: int) -> int:
        return int(erf(normal(time_ns) * half) * jitter_ns)

    def as_pareto(time_ns: int) -> int:
        above = max(1e-6, 0.5 - 0.5 * erf(normal(time_ns) * half))
        return int(min(CUT, (math.pow(above, -1.0 / PARETO_SHAPE) - 1.5) * 4.0 / 3.0) * jitter_ns)

    return {"normal": as_normal, "uniform": as_uniform, "pareto": as_pareto}[distribution]


@cache
def _shuffled(distribution: str, seed: int, name: str) -> tuple[float, ...]:
    """Every quantile once, shuffled by the seed. Cached: an event that changes the jitter must take no time."""
    values = list(_quantiles(distribution))
    generator(seed, name, "jitter").shuffle(values)
    return tuple(values)


@cache
def _quantiles(distribution: str) -> tuple[float, ...]:
    return tuple(quantile(distribution, (number + 0.5) / TABLE_SIZE) for number in range(TABLE_SIZE))


def _place(slot: int) -> int:
    """The index of a slot's value in the table; each pass through the table has another order than the one before."""
    return (slot ^ (slot >> 14) * 0x9E5) & _MASK
