"""One drone as a ground station sees it."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..core.clock import RemoteClock
from ..protocol.control import DroneRecord
from ..protocol.state_payload import StampedState


@dataclass
class HeardState:
    """A state with its stamps, when it came in the station's own time, and the clock that its relay stamp is of.

    `said_ms` bounds from below when it was said, in the own time, once that clock is known.
    """

    message: StampedState
    received_ms: int
    clock: RemoteClock | None
    said_ms: int | None = None

    def age_ms(self, now_ms: int) -> int | None:
        """Upper bound of its age; None before the fog has echoed this station."""
        if self.said_ms is None and self.clock is not None and self.message.relay_stamp is not None:
            age_ms = self.clock.age_ms(self.message.relay_stamp, now_ms)
            self.said_ms = None if age_ms is None else now_ms - age_ms
        return None if self.said_ms is None else now_ms - self.said_ms


@dataclass
class DroneView:
    """One drone of a fog. `clock` is what the drone's own beacons say, where they are signed.

    `session` is the drone's in the fog's newest record of it that names one: an older beacon may be repeated.
    """

    number: int
    clock: RemoteClock | None = None
    session: int | None = None
    next_grant_ms: int = 0
    record: DroneRecord | None = None
    holder: str | None = None
    reachable: bool = False
    states: dict[str, HeardState] = field(default_factory=dict)

    @property
    def signing_clock(self) -> RemoteClock | None:
        """The clock that signed commands are due in; None before drone and fog have named the same session."""
        return self.clock if self.clock is not None and self.clock.session == self.session else None
