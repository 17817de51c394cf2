"""The side channel's requests: JSON objects, checked here, by which a test sets the drone's state past all links."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .autopilot import Autopilot, FlightMode
from .errors import SitlError
from .progress import is_progress

_MESSAGES = frozenset(kind.msgname for kind in mavlink.mavlink_map.values())


def parse(request: Any, modes: type[FlightMode]) -> dict[str, Any] | None:
    """The fields of a `{"set": {...}}`, or None for a `{"get": "state"}`. Raises SitlError for other requests."""
    if request == {"get": "state"}:
        return None
    if not isinstance(request, dict) or set(request) != {"set"} or not isinstance(request["set"], dict):
        raise SitlError(f'{request}: expected {{"get": "state"}} or {{"set": {{...}}}}')
    wanted: dict[str, Any] = request["set"]
    names = [mode.name.lower() for mode in modes]
    checks = {"mode": (names.__contains__, "one of " + ", ".join(names)), **_CHECKS}
    for name, value in wanted.items():
        if name not in checks:
            raise SitlError(f"set {name}: expected one of {', '.join(checks)}")
        right, expected = checks[name]
        if not right(value):
            raise SitlError(f"set {name}: expected {expected}, got {value!r}")
    return wanted


def apply(autopilot: Autopilot, wanted: dict[str, Any]) -> None:
    """Set the drone's state. `armed` or `altitude_m` first put it back home, charged; `mode` is set as by a pilot."""
    autopilot.healthy = wanted.get("healthy", autopilot.healthy)
    is_put_back = "armed" in wanted or "altitude_m" in wanted
    if "battery_pct" in wanted or is_put_back:
        autopilot.battery.charge(wanted.get("battery_pct", 100.0))
    if is_put_back:
        autopilot.put_back(altitude_m=wanted.get("altitude_m", 0.0), armed=wanted.get("armed", False))
    if "mode" in wanted:
        autopilot.enter(type(autopilot.rest)[wanted["mode"].upper()])


def state(autopilot: Autopilot) -> dict[str, Any]:
    """The drone's true state, without noise or link."""
    guidance = autopilot.guidance
    return {
        "mode": autopilot.mode.name.lower(),
        "armed": autopilot.armed,
        "landed": autopilot.landed,
        "healthy": autopilot.healthy,
        "latitude_deg": round(guidance.place.latitude_deg, 7),
        "longitude_deg": round(guidance.place.longitude_deg, 7),
        "altitude_m": round(guidance.motion.position[2] - guidance.home_up_m, 3),
        "groundspeed_m_s": round(guidance.motion.groundspeed_m_s, 3),
        "battery_pct": round(autopilot.battery.remaining_pct, 2),
    }


def _is_number(value: Any, low: float, high: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def _is_flag(value: Any) -> bool:
    return isinstance(value, bool)


def _is_mute(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) and name in _MESSAGES for name in value)


_CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "armed": (_is_flag, "true or false"),
    "altitude_m": (lambda value: _is_number(value, 0, 1000), "metres above home from 0 to 1000"),
    "battery_pct": (lambda value: _is_number(value, 0, 100), "a number from 0 to 100"),
    "healthy": (_is_flag, "true or false"),
    "mute": (_is_mute, "a list of MAVLink messages such as COMMAND_ACK; an empty one ends it"),
    "in_progress": (
        is_progress,
        'a command that takes its time: {"command": N, "percents": [0..255, ...], "interval_s": 0.02..60}',
    ),
}
