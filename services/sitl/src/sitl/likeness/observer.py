"""Observes one link to an autopilot: its latest state, waits for conditions, and the facts of a case."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .channel import Channel, Heard
from .manners import Manners
from .recording import Case

PATIENCE = 5.0
"""How many times slower than the wall clock an autopilot's clock may be."""
_CLOCKS = ("ATTITUDE", "ATTITUDE_QUATERNION", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")
LANDED = {0: "undefined", 1: "on_ground", 2: "in_air", 3: "takeoff", 4: "landing"}


class Timeout(Exception):
    """A case has waited in vain for a condition: it cannot be recorded."""


class Observer(ABC):
    """One link to an autopilot, the last message of each kind on it, and the facts of the present case."""

    def __init__(self, channel: Channel, manners: Manners, system: int) -> None:
        self._channel = channel
        self.manners = manners
        self.system = system
        self.last: dict[str, Any] = {}
        self.case = Case()
        self._boot_s: float | None = None
        self._began_s = self._commanded_s = self._clock_s
        self._origin: tuple[float, float, float] | None = None
        self._known: dict[str, str] = {}
        self._track_due_s = math.inf
        self._taps: list[Callable[[Heard], None]] = []

    @abstractmethod
    def _send_what_is_due(self, now_s: float) -> None:
        """Send the repeated messages that are due at a time of the channel's clock."""

    # -- the state ----------------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Seconds since the case began."""
        return self._clock_s - self._began_s

    @property
    def _clock_s(self) -> float:
        """The autopilot's own clock: a simulation on a busy machine is slower than the wall clock."""
        return self._channel.now_s if self._boot_s is None else self._boot_s

    @property
    def armed(self) -> bool:
        return self._known.get("armed") == "true"

    @property
    def mode(self) -> str:
        return self._known.get("mode", "")

    @property
    def landed(self) -> bool:
        return self._known.get("landed_state") == "on_ground"

    @property
    def ready(self) -> bool:
        """Whether it reports that it could arm now."""
        status = self.last.get("SYS_STATUS")
        healthy = 0 if status is None else status.onboard_control_sensors_health
        return bool(healthy & mavlink.MAV_SYS_STATUS_PREARM_CHECK) and "HOME_POSITION" in self.last

    @property
    def position(self) -> tuple[float, float, float]:
        """Metres north, east and up of the place where the case began."""
        at = self.last["LOCAL_POSITION_NED"]
        origin = self._origin or (0.0, 0.0, 0.0)
        return at.x - origin[0], at.y - origin[1], -at.z - origin[2]

    @property
    def speed_m_s(self) -> float:
        at = self.last["LOCAL_POSITION_NED"]
        return math.sqrt(at.vx**2 + at.vy**2 + at.vz**2)

    # -- the case -----------------------------------------------------------------------------------------------

    def begin(self, *, everything: bool = True) -> None:
        """Start a new case, here and now."""
        self._channel.attend(everything)
        self._known = {}
        self._origin = None
        self._track_due_s = math.inf
        self.until("", lambda: {"armed", "mode", "landed_state"} <= self._known.keys() and bool(self._place()), 20)
        self._origin = self._place()
        self._began_s = self._commanded_s = self._clock_s
        self.case = Case()

    def _place(self) -> tuple[float, float, float] | None:
        at = self.last.get("LOCAL_POSITION_NED")
        return None if at is None else (at.x, at.y, -at.z)

    def track(self) -> None:
        """Record the position once per second from now on."""
        self._track_due_s = self._clock_s

    def until(self, name: str, condition: Callable[[], bool], limit_s: float) -> None:
        """Wait for a condition, and record how long after the last command it holds. Raises Timeout."""
        end_s, given_up_s = self._clock_s + limit_s, self._channel.now_s + PATIENCE * limit_s
        while not condition():
            if self._clock_s >= end_s or self._channel.now_s >= given_up_s:
                raise Timeout(f"{name}: not within {limit_s:g} s: {self._known} {self.case.acks}")
            self._listen(0.02)
        if name:
            self.case.durations_s[name] = round(self._clock_s - self._commanded_s, 2)

    def mark(self) -> None:
        """Count durations from now on."""
        self._commanded_s = self._clock_s

    def wait(self, seconds: float) -> None:
        end_s, given_up_s = self._clock_s + seconds, self._channel.now_s + PATIENCE * seconds
        while (left_s := end_s - self._clock_s) > 1e-6 and self._channel.now_s < given_up_s:
            self._listen(min(0.1, left_s))

    def collect(self, seconds: float) -> list[Heard]:
        """Wait for `seconds`, and return every message received meanwhile."""
        heard: list[Heard] = []
        tap = heard.append
        self.tap(tap)
        self.wait(seconds)
        self.untap(tap)
        return heard

    def tap(self, take: Callable[[Heard], None]) -> None:
        """Pass every message received from now on to `take`."""
        self._taps.append(take)

    def untap(self, take: Callable[[Heard], None]) -> None:
        self._taps.remove(take)

    # -- received messages --------------------------------------------------------------------------------------

    def _listen(self, seconds: float) -> None:
        self._send_what_is_due(self._channel.now_s)
        for heard in self._channel.listen(seconds):
            self._take(heard)
        if self._clock_s >= self._track_due_s and "LOCAL_POSITION_NED" in self.last:
            self._track_due_s += 1.0
            self.case.track.append((round(self.now_s, 1), *(round(value, 2) for value in self.position)))

    def _take(self, heard: Heard) -> None:
        message = heard.message
        if heard.system != self.system:
            return
        kind = heard.kind
        self.last[kind] = message
        if kind in _CLOCKS:
            self._boot_s = message.time_boot_ms / 1000
        if kind == "HEARTBEAT" and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
            self._change("armed", str(bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)).lower())
            self._change("mode", self.manners.mode_name(message.custom_mode))
        elif kind == "EXTENDED_SYS_STATE":
            self._change("landed_state", LANDED.get(message.landed_state, "undefined"))
        for tap in self._taps:
            tap(heard)

    def _change(self, what: str, value: str) -> None:
        if self._known.get(what) != value:
            if what in self._known:
                self.case.events.append((round(self.now_s, 2), what, value))
            self._known[what] = value
