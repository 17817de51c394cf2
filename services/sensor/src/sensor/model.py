"""A model of a sensor's values: a daily course with slow noise. The same seed and time give the same value.

The noise is first-order autoregressive over the seconds since 1970, cut off after `_MEMORY` seconds so that it
depends on seed and time alone, and bounded by its amplitude.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import cos, exp, pi

DAY_S = 86_400
_KEEPS = 0.9
"""The share of a second's noise that remains in the next."""
_MEMORY = 64


@dataclass(frozen=True)
class SimulatedQuantity:
    """A kind of value: its course over a day (0 to 1) in its unit, the noise's amplitude, its bounds and decimals."""

    kind: str
    unit: str
    course: Callable[[float], float]
    noise: float
    low: float
    high: float
    decimals: int


def _warmth(day: float) -> float:
    """From 0 before dawn (03:00 UTC) to 1 in the afternoon."""
    return (1 - cos(2 * pi * (day - 3 / 24))) / 2


def _sun(day: float) -> float:
    """0 at night, 1 at noon UTC."""
    return max(0.0, -cos(2 * pi * day))


QUANTITIES = {
    quantity.kind: quantity
    for quantity in (
        SimulatedQuantity("temperature", "degC", lambda day: 8 + 14 * _warmth(day), 0.6, -40, 60, 2),
        SimulatedQuantity("humidity", "%", lambda day: 85 - 45 * _warmth(day), 3, 0, 100, 1),
        SimulatedQuantity("light", "lx", lambda day: 50_000 * _sun(day) * exp(_sun(day) - 1), 400, 0, 120_000, 0),
    )
}


def value(kind: str, unix_ms: int, seed: int) -> float:
    """The value of a kind at a time in ms since 1970, rounded to the kind's decimals."""
    quantity = QUANTITIES[kind]
    second, part_ms = divmod(unix_ms, 1000)
    course = quantity.course(unix_ms / 1000 % DAY_S / DAY_S)
    here, next_one = noise(kind, second, seed), noise(kind, second + 1, seed)
    found = course + quantity.noise * (here + (next_one - here) * part_ms / 1000)
    return round(min(max(found, quantity.low), quantity.high), quantity.decimals)


@lru_cache(maxsize=64)
def noise(kind: str, second: int, seed: int) -> float:
    """A second's noise, from -1 to 1, close to that of the second before."""
    return (1 - _KEEPS) * sum(_KEEPS**ago * _shock(kind, second - ago, seed) for ago in range(_MEMORY))


@lru_cache(maxsize=1024)
def _shock(kind: str, second: int, seed: int) -> float:
    """The new part of a second's noise, uniform from -1 to 1."""
    digest = hashlib.blake2b(f"{seed}/{kind}/{second}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") / 2**63 - 1
