"""Sessions and clocks: a process's own time, and the bounds that it has on another process's time.

Specification: docs/protocol.md, section 4. Everything here is arithmetic on milliseconds; only
`system_clock_ns` reads a clock. A deadline is always expressed in the *executor's* session clock, so
that no stall between sender and executor, however long, can make a command run late.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

_PARTS = 1000
RHO = 1 / _PARTS
"""Largest relative error of a clock's rate that the bounds allow for (1 ms per second)."""

_SLOWEST, _SLOWEST_OF = _PARTS - 2, _PARTS
"""1 - 2 rho: the least that passes on another clock while 1 passes here, because it is below (1 - rho) / (1 + rho).

A fraction of whole numbers: no rounding error accumulates, however long a session lasts.
"""
_FASTEST, _FASTEST_OF = _PARTS + 1, _PARTS - 1
"""(1 + rho) / (1 - rho): the most that passes there; 1 + 2 rho would be too little by 2 rho squared."""

MAX_TTL_MS = 60_000
DEFAULT_TTL_MS = 5_000
BEACON_INTERVAL_MS = 10_000
LIVE_INTERVALS = 3
"""A process is no longer live after this many intervals without a beacon."""

LATEST_MS = 2**53 - 1
"""The latest time that a payload can carry, ms (JSON's numbers are exact up to it)."""

STAMP_TICK_MS = 10
STAMP_MODULUS = 1 << 16
_STAMP_SPAN_MS = STAMP_MODULUS * STAMP_TICK_MS


def system_clock_ns() -> int:
    """Nanoseconds of a clock that NTP does not slew and suspend does not stop.

    On Linux CLOCK_MONOTONIC_RAW is not slewed but stops in suspend; the time spent in suspend is the difference between
    CLOCK_BOOTTIME and CLOCK_MONOTONIC (clock_gettime(2)). On macOS CLOCK_MONOTONIC_RAW goes on in suspend. On Windows
    QueryPerformanceCounter is such a clock; Python's monotonic clock there may have ticks of 16 ms, which would make
    a deadline late by as much.
    """
    if not hasattr(time, "clock_gettime_ns"):
        return time.perf_counter_ns()
    raw = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
    boottime = getattr(time, "CLOCK_BOOTTIME", None)
    if boottime is None:
        return raw
    suspended = time.clock_gettime_ns(boottime) - time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    return raw + max(0, suspended)


class SessionClock:
    """One process's session: a random number, and milliseconds since the process started.

    `source` returns nanoseconds; tests pass clocks of their own.
    """

    def __init__(self, source: Callable[[], int] = system_clock_ns, session: int | None = None) -> None:
        self._source = source
        self._start_ns = source()
        self.session = session if session is not None else secrets.randbelow(2**32 - 1) + 1

    def now_ms(self) -> int:
        """Whole milliseconds since the session began; never goes back."""
        return (self._source() - self._start_ns) // 1_000_000


def stamp(now_ms: int) -> int:
    """The 16-bit stamp (ticks of 10 ms) of a session time."""
    return (now_ms // STAMP_TICK_MS) % STAMP_MODULUS


def stamp_is_newer(candidate: int, reference: int) -> bool:
    """Whether `candidate` was taken after `reference`, for stamps less than 5.4 minutes apart."""
    return 0 < (candidate - reference) % STAMP_MODULUS < STAMP_MODULUS // 2


def stamp_supersedes(candidate: int, reference: int, elapsed_ms: int) -> bool:
    """Whether `candidate`, received `elapsed_ms` after `reference`, replaces it.

    After a quarter of the stamps' span (164 s) their order is no longer reliable, and the later arrival counts. States
    are repeated every 30 s, so a drone that was out of reach for minutes is shown again at once.
    """
    return elapsed_ms > _STAMP_SPAN_MS // 4 or stamp_is_newer(candidate, reference)


@dataclass(frozen=True)
class Beacon:
    """The reading of a process's own clock: `[session, now_ms, echoed nonce, held_ms]`.

    `held_ms` is how long the nonce waited in the sender between its receipt and this beacon.
    """

    session: int
    now_ms: int
    nonce: int | None = None
    held_ms: int | None = None


class RemoteClock:
    """Two bounds on another process's clock, for one of its sessions.

    The lower bound comes from any beacon: it was sent before it arrived, so on arrival the remote clock reads at
    least T. The upper bound comes from an echo: the nonce was sent before it was received, so when it was sent the
    remote clock read at most T - held. A delayed beacon only makes the lower bound lower (deadlines earlier) and the
    upper bound higher (ages larger): both are safe.

    While both clocks keep within rho, no beacon can contradict an earlier one. One that does shows that a clock was
    stepped or stood still; both bounds are then forgotten. The derivation is in docs/deadlines.md.
    """

    def __init__(self, session: int) -> None:
        self.session = session
        self.last_beacon_ms: int | None = None
        """Latest own time at which the newest beacon can have been sent, by the remote clock that it carries."""
        self._lower_offset: int | None = None  # in 1 / _SLOWEST_OF ms
        self._upper_offset: int | None = None  # in 1 / _FASTEST_OF ms

    def observe(self, beacon: Beacon, received_ms: int, asked_ms: int | None = None) -> None:
        """Take in a beacon that was received at the own time `received_ms`; raises ValueError for another session's.

        `asked_ms` is the own time at which the echoed nonce was sent, None if the nonce is not this process's.
        """
        if beacon.session != self.session:
            raise ValueError(f"beacon of session {beacon.session}, expected {self.session}")
        latest = self.latest_now_ms(received_ms)
        if latest is not None and beacon.now_ms > latest:
            self._lower_offset = self._upper_offset = None
        if asked_ms is not None and beacon.held_ms is not None:
            upper = (beacon.now_ms - beacon.held_ms + 2) * _FASTEST_OF - asked_ms * _FASTEST
            earliest = self.deadline_ms(received_ms, 0)
            if earliest is not None and earliest * _FASTEST_OF > upper + (received_ms + 1) * _FASTEST:
                self._lower_offset = self._upper_offset = None
            if self._upper_offset is None or upper < self._upper_offset:
                self._upper_offset = upper
        least_ms = self.deadline_ms(received_ms, 0) if self._lower_offset is not None else None
        behind_ms = max(0, least_ms - beacon.now_ms) if least_ms is not None else 0
        self.last_beacon_ms = max(received_ms - behind_ms, self.last_beacon_ms or 0)
        lower = beacon.now_ms * _SLOWEST_OF - (received_ms + 1) * _SLOWEST
        if self._lower_offset is None or lower > self._lower_offset:
            self._lower_offset = lower

    def deadline_ms(self, now_ms: int, ttl_ms: int) -> int | None:
        """D = T + (now - r)(1 - 2 rho) + ttl (1 - 2 rho), the largest over all beacons; None without one.

        Clocks are read in whole milliseconds: r counts as one more, and D is one less because the executor's
        clock still reads D for almost a millisecond after it. D never exceeds LATEST_MS, whatever a beacon claims.
        """
        if self._lower_offset is None:
            return None
        found = (self._lower_offset + (now_ms + ttl_ms) * _SLOWEST) // _SLOWEST_OF - 1
        return min(found, LATEST_MS)

    def latest_now_ms(self, now_ms: int) -> int | None:
        """Latest time that the remote clock can show at the own time `now_ms`; None before an echo."""
        if self._upper_offset is None:
            return None
        return -(-(self._upper_offset + (now_ms + 1) * _FASTEST) // _FASTEST_OF)

    def age_ms(self, stamped: int, now_ms: int) -> int | None:
        """Upper bound of the age of a message that the remote process stamped, ms; None before an echo."""
        latest = self.latest_now_ms(now_ms)
        if latest is None:
            return None
        return (latest - stamped * STAMP_TICK_MS) % _STAMP_SPAN_MS

    def is_live(self, now_ms: int, interval_ms: int = BEACON_INTERVAL_MS) -> bool:
        """Whether a beacon was sent within the last three intervals; repeating an old one does not make it younger."""
        return self.last_beacon_ms is not None and now_ms - self.last_beacon_ms <= LIVE_INTERVALS * interval_ms


def expiry_s(remaining_ms: float) -> int:
    """MQTT message expiry, s, for a message with `remaining_ms` to live: housekeeping only, at least 1 (R4.9)."""
    return max(1, ceil(remaining_ms / 1000))
