"""How long a full battery lasts in flight: configured, or measured from the battery's drain in the air."""

from __future__ import annotations

from typing import Any

from ..protocol.states import Battery, Endurance, Landed, LandedState
from .mavlink.vehicle import Vehicle
from .options import LONGEST_S, SHORTEST_S

ENOUGH_PCT = 3
"""How much has to drain before a measurement counts: autopilots report whole percents."""
_IN_AIR = (Landed.IN_AIR, Landed.TAKEOFF, Landed.LANDING)


class EnduranceMeter:
    """Makes the state `endurance` of one drone, once endurance and cruise speed are known.

    The measurement never exceeds the truth: it divides the time in the air, up to the last message before the percent
    dropped, by all that drained, in the air or not.
    """

    def __init__(self, vehicle: Vehicle, configured_s: int | None = None) -> None:
        self._vehicle = vehicle
        self._configured_s = configured_s
        self._measured_s: int | None = None
        self._full_pct: int | None = None
        self._last_pct = 0
        self._last_ms = 0
        self._air_ms = 0
        self._told: Endurance | None = None

    def on_message(self, message: Any, now_ms: int) -> Endurance | None:
        """Take in a message, after the vehicle; returns the state if it has changed."""
        kind = message.get_type()
        if kind == "BATTERY_STATUS" and self._configured_s is None:
            self._on_battery(now_ms)
        elif kind != "PARAM_VALUE":
            return None
        cruise_m_s = self._vehicle.cruise_m_s
        endurance_s = self._configured_s or self._measured_s
        if cruise_m_s is None or endurance_s is None:
            return None
        state = Endurance(endurance_s, cruise_m_s)
        if state == self._told:
            return None
        self._told = state
        return state

    def _on_battery(self, now_ms: int) -> None:
        battery = self._vehicle.seen(Battery)
        if battery is None:
            return
        percent = battery.remaining_pct
        if self._full_pct is None or percent > self._last_pct:  # the first reading, or another battery
            self._full_pct, self._air_ms = percent, 0
        else:
            drained = self._full_pct - percent
            if percent < self._last_pct and drained >= ENOUGH_PCT and self._air_ms > 0:
                measured_s = self._air_ms // (10 * drained)
                self._measured_s = min(LONGEST_S, max(SHORTEST_S, measured_s))
            landed = self._vehicle.seen(LandedState)
            if landed is not None and landed.landed in _IN_AIR:
                self._air_ms += now_ms - self._last_ms
        self._last_pct, self._last_ms = percent, now_ms
