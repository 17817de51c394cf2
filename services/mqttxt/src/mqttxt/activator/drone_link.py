"""One drone at its activator: the session bound to its number, its clock and last states."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..core.clock import RemoteClock, stamp_supersedes
from ..protocol.state_payload import PlainState

STATE_KEPT_MS = 600_000
"""Older states are no longer published, because a stamp's span is 655 s."""


@dataclass(slots=True)
class Known:
    """A state as received. `said_ms` is the earliest time at which the drone sent it, once its clock is known."""

    state: PlainState
    received_ms: int
    said_ms: int | None = None


@dataclass
class DroneLink:
    """One drone: the session bound to its number, and everything known of it."""

    number: int
    session: int | None = None
    up: bool = False
    announced: bool = False
    clock: RemoteClock | None = None
    states: dict[str, Known] = field(default_factory=dict)
    nonces: dict[int, int] = field(default_factory=dict)
    challenger: int | None = None
    challenger_paths: set[str] = field(default_factory=set)
    contest_until_ms: int = 0
    next_lease_ms: int = 0
    in_offboard: bool = False
    knows_certificate: bool = False
    heard_ms: int | None = None
    leases: int = 0
    told_until_ms: int | None = None
    """The end of the station's control, in our clock, that the newest lease has handed down."""
    paths: set[str] = field(default_factory=set)
    """The connections over which the bound session is present."""
    path: str = ""
    """The connection of its newest beacon: the better one, as the drone measures them."""
    gone_at_ms: int | None = None
    """When the drone counts as gone, unless it echoes a lease sent at most `CONTEST_MS` before that."""
    missed: bool = False
    """Whether the drone's connection was lost, and it has not echoed a lease since then (`anew` in R6.10)."""

    def age_ms(self, name: str, now_ms: int) -> int | None:
        """Upper bound of a state's age, ms; None if it or the drone's clock is not known."""
        known = self.states.get(name)
        said_ms = None if known is None else self.said_ms(known, now_ms)
        return None if said_ms is None else now_ms - said_ms

    def said_ms(self, known: Known, now_ms: int) -> int | None:
        """The earliest own time at which the drone sent a state; None if it is too old, or the drone's clock unknown.

        Computed once per state: a later bound of the drone's clock does not apply to earlier times.
        """
        if self.clock is None or now_ms - known.received_ms > STATE_KEPT_MS:
            return None
        if known.said_ms is None:
            age_ms = self.clock.age_ms(known.state.stamp, now_ms)
            known.said_ms = None if age_ms is None else now_ms - age_ms
        return known.said_ms

    def is_live(self, now_ms: int, interval_ms: int) -> bool:
        return self.up and self.clock is not None and self.clock.is_live(now_ms, interval_ms)

    def bind(self, session: int, paths: set[str]) -> None:
        """Bind the number to a new session, of which nothing is known yet except that it is present over `paths`."""
        self.session = session
        self.challenger = None
        self.paths = set(paths)
        self.path = min(paths)
        self.gone_at_ms = None
        self.up = True
        self.clock = RemoteClock(session)
        self.states.clear()
        self.nonces.clear()
        self.knows_certificate = False
        self.heard_ms = None

    def next_lease(self) -> int:
        """The counter of the next lease."""
        self.leases += 1
        return self.leases

    def keep_state(self, state: PlainState, before: Known | None, now_ms: int) -> Known | None:
        """Keep a state, and return it, if it is newer than the one `before`; None if it is not."""
        if self.clock is None:
            return None
        if before is not None and not stamp_supersedes(state.stamp, before.state.stamp, now_ms - before.received_ms):
            return None
        known = self.states[state.name] = Known(state, now_ms)
        return known
