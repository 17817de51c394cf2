"""QoDS, quality of drone services: the available drones of a fog, best first (docs/protocol.md, section 8)."""

from __future__ import annotations

from collections.abc import Iterable

from ..protocol.rankings import Ranked
from ..protocol.states import Battery, MaxGroundspeed
from .drone_link import DroneLink

DECILES = 10
HEARTBEAT_MS = 30_000
LOOK_MS = 500
"""Shortest time between two computations: with hundreds of drones some figure changes all the time."""
USED = frozenset({Battery.name, MaxGroundspeed.name})
"""The states by which drones are ranked."""


def rank(links: Iterable[DroneLink], stale_ms: int, now_ms: int) -> tuple[Ranked, ...]:
    """The reachable drones by battery decile, higher first, then by largest groundspeed, then by number."""
    return tuple(_ranked(link, now_ms) for *_, link in _places(links, stale_ms, now_ms))


def decile(remaining_pct: int) -> int:
    """The group of ten percent that a battery is in; 100 % is in the highest."""
    return min(DECILES - 1, remaining_pct // 10)


def _places(links: Iterable[DroneLink], stale_ms: int, now_ms: int) -> list[tuple[int, int, int, DroneLink]]:
    """Each reachable drone whose figures are known and fresh, best first, after its sort keys.

    It sorts by CBOR's integers, without decoding the states: it runs twice per second, for a result rarely published.
    """
    found = []
    for link in links:
        ages = [link.age_ms(name, now_ms) for name in USED] if link.announced else [None]
        if all(age is not None and age <= stale_ms for age in ages):
            remaining_pct, speed = (link.states[name].state.item[1] for name in (Battery.name, MaxGroundspeed.name))
            found.append((-decile(remaining_pct), -speed, link.number, link))
    found.sort()
    return found


def _ranked(link: DroneLink, now_ms: int) -> Ranked:
    """The entry of a drone whose figures are known."""
    remaining, speed = link.states[Battery.name].state.state, link.states[MaxGroundspeed.name].state.state
    assert isinstance(remaining, Battery)
    assert isinstance(speed, MaxGroundspeed)
    return Ranked(
        drone=link.number,
        remaining_pct=remaining.remaining_pct,
        max_groundspeed_m_s=speed.max_groundspeed_m_s,
        age_s=max(link.age_ms(name, now_ms) or 0 for name in USED) / 1000,
    )


class QodsTurns:
    """Decides when to publish the ranking: when the order or a decile has changed, and every 30 s (R8.2)."""

    def __init__(self) -> None:
        self.touched = True
        self._published: tuple[tuple[int, int], ...] | None = None
        self._at_ms = 0
        self._look_after_ms = 0

    def forget(self) -> None:
        """Publish the ranking again, for a station that has registered."""
        self._published = None
        self._look_after_ms = 0
        self.touched = True

    def due(self, links: Iterable[DroneLink], stale_ms: int, now_ms: int) -> tuple[Ranked, ...] | None:
        """The ranking if it is to be published now, else None; not computed while `touched` is false."""
        beats = now_ms - self._at_ms >= HEARTBEAT_MS
        if not beats and (not self.touched or now_ms < self._look_after_ms):
            return None
        self.touched = False
        self._look_after_ms = now_ms + LOOK_MS
        places = _places(links, stale_ms, now_ms)
        shape = tuple((number, -place) for place, _, number, _ in places)
        if shape == self._published and not beats:
            return None
        self._published = shape
        self._at_ms = now_ms
        return tuple(_ranked(link, now_ms) for *_, link in places)
