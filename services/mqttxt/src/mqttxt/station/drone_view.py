"""One drone as a ground station sees it."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..core.clock import STAMP_MODULUS, STAMP_TICK_MS, RemoteClock
from ..protocol.control import DroneRecord
from ..protocol.state_payload import StampedState

_STAMP_SPAN_MS = STAMP_MODULUS * STAMP_TICK_MS


@dataclass
class HeardState:
    """A state with its stamps, when it arrived by the station's clock, and the clock of its relay stamp.

    `said_ms` is a lower bound of when it was published, by the station's clock, once the relay's clock is known.
    """

    message: StampedState
    received_ms: int
    clock: RemoteClock | None
    said_ms: int | None = None

    def age_ms(self, now_ms: int) -> int | None:
        """An upper bound of its age; None before the fog has echoed a nonce of this station.

        It is no younger than its arrival: where the echo, or the question, came later, the stamps may have come round.
        """
        if self.said_ms is None and self.clock is not None and self.message.relay_stamp is not None:
            age_ms = self.clock.age_ms(self.message.relay_stamp, now_ms)
            if age_ms is not None:
                rounds = max(0, -((age_ms - (now_ms - self.received_ms)) // _STAMP_SPAN_MS))
                self.said_ms = now_ms - age_ms - rounds * _STAMP_SPAN_MS
        return None if self.said_ms is None else now_ms - self.said_ms


@dataclass
class DroneView:
    """One drone of a fog. `clock` follows the drone's own beacons, where they are signed.

    `session` is the one in the fog's newest record that names one; a beacon may be an old one, replayed.
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
        """The clock of signed commands' deadlines; None before drone and fog have named the same session."""
        return self.clock if self.clock is not None and self.clock.session == self.session else None
