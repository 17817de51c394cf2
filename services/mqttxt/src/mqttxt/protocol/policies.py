"""When a change of a state is worth publishing (docs/protocol.md, section 3)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from .commands import haversine_m
from .states import Armed, AutopilotText, Battery, Gps, Groundspeed, Heading, Home, Location, Power, State, VelocityNed


def _any_change(old: State, new: State) -> bool:
    return old != new


@dataclass(frozen=True)
class Policy:
    """When a state is published: beyond its deadband, at most at its rate, at least once per heartbeat interval.

    `exceeds(old, new)`: whether the change is larger than the deadband, which `deadband` has in words. With
    `is_for_rest` the deadband is for a disarmed drone, and an armed one publishes any change.
    """

    exceeds: Callable[[Any, Any], bool]
    min_interval_ms: int
    heartbeat_ms: int = 30_000
    deadband: str = "any change"
    is_for_rest: bool = False


def _beyond(
    limit: float,
    unit: str,
    change: Callable[[Any, Any], float],
    words: str = "",
    rest: bool = False,
    heartbeat_ms: int = 30_000,
) -> Policy:
    """Publish changes larger than `limit`; `words` follow it in the specification's table."""
    said = f"{limit:g}{unit}{words}"
    return Policy(lambda old, new: change(old, new) > limit, 1000, heartbeat_ms, said, rest)


def _across_m(old: Location | Home, new: Location | Home) -> float:
    return haversine_m(old.latitude_deg, old.longitude_deg, new.latitude_deg, new.longitude_deg)


def _up_m(old: Location | Home, new: Location | Home) -> float:
    return abs(old.altitude_amsl_m - new.altitude_amsl_m)


def _moved_m(old: Location, new: Location) -> float:
    return max(_across_m(old, new), _up_m(old, new), abs(old.altitude_m - new.altitude_m))


def _home_moved_m(old: Home, new: Home) -> float:
    return max(_across_m(old, new), _up_m(old, new))


def _gained_pct(old: Battery, new: Battery) -> float:
    """The gain; a loss is infinite. A loaded battery's readings alternate: each is published once while it drains."""
    gained = new.remaining_pct - old.remaining_pct
    return math.inf if gained < 0 else gained


def _turned_deg(old: Heading, new: Heading) -> float:
    turn = abs(old.heading_deg - new.heading_deg) % 360
    return min(turn, 360 - turn)


def _sped_m_s(old: Groundspeed, new: Groundspeed) -> float:
    return abs(old.groundspeed_m_s - new.groundspeed_m_s)


def _changed_m_s(old: VelocityNed, new: VelocityNed) -> float:
    """The change along the axis that has changed most."""
    return max(abs(old.north_m_s - new.north_m_s), abs(old.east_m_s - new.east_m_s), abs(old.down_m_s - new.down_m_s))


def _is_other_reception(old: Gps, new: Gps) -> bool:
    """Beyond the single satellites that always come and go."""
    if old.fix is not new.fix or (old.satellites is None) != (new.satellites is None):
        return True
    return abs((old.satellites or 0) - (new.satellites or 0)) > SATELLITES or _beyond_hdop(old.hdop, new.hdop)


def _beyond_hdop(old: float | None, new: float | None) -> bool:
    if old is None or new is None:
        return old is not new
    return abs(old - new) > HDOP


def _is_other_power(old: Power, new: Power) -> bool:
    if (old.current_a is None) != (new.current_a is None):
        return True
    return abs(old.voltage_v - new.voltage_v) > VOLTS or abs((old.current_a or 0) - (new.current_a or 0)) > AMPERES


SATELLITES, HDOP = 2, 0.5
VOLTS, AMPERES = 0.2, 5.0
VELOCITY_MS = 3000
"""The longest interval of `velocity`, which shows a station within seconds that it still receives the drone."""
_URGENTLY = Policy(_any_change, min_interval_ms=100)
_AT_ONCE = Policy(_any_change, min_interval_ms=1000)
HOME_M = 1.0
"""Beyond this distance home is at another place: PX4 moves it by up to 0.7 m across and 1.2 m up, every two seconds,
while its position settles."""

POLICIES: dict[str, Policy] = {
    "battery": _beyond(1, " %", _gained_pct, " more, any less"),
    "location": _beyond(0.5, " m", _moved_m),
    "heading": _beyond(5, "°", _turned_deg),
    "groundspeed": _beyond(0.5, " m/s", _sped_m_s),
    "flight_mode": _URGENTLY,
    "armed": _URGENTLY,
    "landed_state": _URGENTLY,
    "max_groundspeed": _AT_ONCE,
    "home": _beyond(HOME_M, " m, any change while armed", _home_moved_m, rest=True),
    "health": _AT_ONCE,
    "endurance": _AT_ONCE,
    "velocity": _beyond(0.5, " m/s along an axis", _changed_m_s, heartbeat_ms=VELOCITY_MS),
    "gps": Policy(_is_other_reception, 5000, deadband=f"another fix, {SATELLITES} satellites, hdop {HDOP:g}"),
    "power": Policy(_is_other_power, 5000, deadband=f"{VOLTS:g} V, {AMPERES:g} A"),
    "airframe": _AT_ONCE,
    "mission": _AT_ONCE,
    "fence": _URGENTLY,
}
"""The defaults; a `text` has none, as it does not last and is published on arrival."""
ON_REQUEST = frozenset({"velocity", "gps", "power", "airframe", AutopilotText.name})
"""States that are published only if an option of the UAV client says so, or while `stream` requests them (R3.11)."""


def is_elsewhere(old: Home, new: Home) -> bool:
    """Whether home was moved to another place, and not only corrected in its altitude."""
    return _across_m(old, new) > HOME_M


URGENT = frozenset({"armed", "flight_mode", "landed_state"})
"""States for which a bundle leaves early."""


class Throttle:
    """Decides when each state of one drone is published, by its policy; states in `apart` are left out."""

    def __init__(self, policies: dict[str, Policy] | None = None) -> None:
        self.apart: frozenset[str] = frozenset()
        self._policies = {**POLICIES, **(policies or {})}
        self._current: dict[str, State] = {}
        self._published: dict[str, tuple[State | None, int]] = {}

    def update(self, state: State) -> None:
        """Take in the newest value of a state."""
        self._current[state.name] = state

    def due(self, now_ms: int) -> list[State]:
        """The states to publish now, in the order of their first appearance; they then count as published."""
        found = self._due(now_ms)
        for state in found:
            self._published[state.name] = (state, now_ms)
        return found

    def current(self, name: str) -> State | None:
        """The newest value of a state."""
        return self._current.get(name)

    def is_due(self, names: Iterable[str], now_ms: int) -> bool:
        """Whether any of the states in `names` would be published now."""
        return any(name in self._current and self._is_due(name, now_ms) for name in names)

    def forget_published(self) -> None:
        """Publish every state at the next `due`: the receiver has lost them."""
        self._published.clear()

    def repeat_published(self) -> None:
        """Publish every state once more, no faster than its rate: some may not have arrived."""
        self._published = {name: (None, at_ms) for name, (_, at_ms) in self._published.items()}

    def _due(self, now_ms: int) -> list[State]:
        return [state for name, state in self._current.items() if self._is_due(name, now_ms)]

    def _is_due(self, name: str, now_ms: int) -> bool:
        """Whether a known state would be published now."""
        if name in self.apart:
            return False
        published = self._published.get(name)
        if published is None:
            return True
        policy, (last, at_ms) = self._policies[name], published
        since_ms = now_ms - at_ms
        if since_ms >= policy.heartbeat_ms:
            return True
        if since_ms < policy.min_interval_ms:
            return False
        any_change = policy.is_for_rest and self._current.get(Armed.name) == Armed(True)
        exceeds = _any_change if any_change else policy.exceeds
        return last is None or exceeds(last, self._current[name])
