"""QoDS, quality of drone services: the available drones of a fog, best first (docs/protocol.md, section 8)."""

from __future__ import annotations

from collections.abc import Iterable

from ..protocol.rankings import Ranked
from ..protocol.states import Battery, MaxGroundspeed
from .drone_link import DroneLink

DECILES = 10
HEARTBEAT_MS = 30_000
LOOK_MS = 500
"""Between two computations: with hundreds of drones something is touched all the time."""
USED = frozenset({Battery.name, MaxGroundspeed.name})
"""The states by which drones are ranked."""


def rank(links: Iterable[DroneLink], stale_ms: int, now_ms: int) -> tuple[Ranked, ...]:
    """The reachable drones by battery decile, higher first, then by largest groundspeed, then by number."""
    found = [ranked for link in links for ranked in [_ranked(link, stale_ms, now_ms)] if ranked is not None]
    return tuple(sorted(found, key=_place))


def decile(remaining_pct: int) -> int:
    """The group of ten percent that a battery is in; 100 % is in the highest."""
    return min(DECILES - 1, remaining_pct // 10)


def _place(ranked: Ranked) -> tuple[int, float, int]:
    return -decile(ranked.remaining_pct), -ranked.max_groundspeed_m_s, ranked.drone


def _ranked(link: DroneLink, stale_ms: int, now_ms: int) -> Ranked | None:
    """A drone's entry; None while it is not reachable or its figures are unknown or old."""
    if not link.announced:
        return None
    battery, fastest = link.states.get(Battery.name), link.states.get(MaxGroundspeed.name)
    ages = [link.age_ms(name, now_ms) for name in USED]
    if battery is None or fastest is None or any(age is None or age > stale_ms for age in ages):
        return None
    remaining, speed = battery.state.state, fastest.state.state
    assert isinstance(remaining, Battery)
    assert isinstance(speed, MaxGroundspeed)
    return Ranked(
        drone=link.number,
        remaining_pct=remaining.remaining_pct,
        max_groundspeed_m_s=speed.max_groundspeed_m_s,
        age_s=max(age for age in ages if age is not None) / 1000,
    )


class QodsTurns:
    """When the ranking is published: when order or a decile has changed, and every 30 s."""

    def __init__(self) -> None:
        self.touched = True
        self._published: tuple[tuple[int, int], ...] | None = None
        self._at_ms = 0
        self._look_after_ms = 0

    def forget(self) -> None:
        """Somebody new listens."""
        self._published = None
        self._look_after_ms = 0
        self.touched = True

    def due(self, links: Iterable[DroneLink], stale_ms: int, now_ms: int) -> tuple[Ranked, ...] | None:
        """The ranking, if it is to be published now. Nothing is computed while nothing was touched."""
        beats = now_ms - self._at_ms >= HEARTBEAT_MS
        if not beats and (not self.touched or now_ms < self._look_after_ms):
            return None
        self.touched = False
        self._look_after_ms = now_ms + LOOK_MS
        ranking = rank(links, stale_ms, now_ms)
        shape = tuple((ranked.drone, decile(ranked.remaining_pct)) for ranked in ranking)
        if shape == self._published and not beats:
            return None
        self._published = shape
        self._at_ms = now_ms
        return ranking
