"""Several connections of a UAV client to its fog: whether they lead to one activator (docs/protocol.md, section 19)."""

from __future__ import annotations

from ..protocol.control import DroneLease
from .effects import Led


class Paths:
    """What leases say of the connections they come by. `first`: the name of the one that counts where two disagree."""

    def __init__(self, first: str, beacon_interval_ms: int) -> None:
        self._first = first
        self._kept_ms = 3 * beacon_interval_ms
        self._activator: tuple[int, int] | None = None
        """The session of the newest lease over the first connection, and when it came."""

    def takes(self, lease: DroneLease, path: str, now_ms: int) -> bool:
        """Whether a lease is of the activator that the first connection leads to, where one is there."""
        if path == self._first:
            self._activator = lease.activator_session, now_ms
        known = self._activator
        return known is None or known[0] == lease.activator_session or now_ms - known[1] > self._kept_ms

    def on_lost(self, path: str | None) -> None:
        """Nothing is known of where a lost connection leads; None: all are lost."""
        if path in (None, self._first):
            self._activator = None

    def led(self, lease: DroneLease, path: str) -> Led:
        """A lease, the same over every connection, has come over one."""
        return Led(path, (lease.activator_session, lease.nonce))
