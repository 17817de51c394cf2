"""Several connections of a UAV client to its fog, and whether they lead to one activator (protocol, section 19)."""

from __future__ import annotations

from ..protocol.control import DroneLease
from .effects import Led


class Paths:
    """The activators that leases show at each connection. `first` names the connection that wins if two disagree."""

    def __init__(self, first: str, beacon_interval_ms: int) -> None:
        self._first = first
        self._kept_ms = 3 * beacon_interval_ms
        self._activator: tuple[int, int] | None = None
        """The activator session and arrival of the newest lease over the first connection."""

    def takes(self, lease: DroneLease, path: str, now_ms: int) -> bool:
        """Whether to take a lease: it is of the first connection's activator, or that is silent or unknown."""
        if path == self._first:
            self._activator = lease.activator_session, now_ms
        known = self._activator
        return known is None or known[0] == lease.activator_session or now_ms - known[1] > self._kept_ms

    def on_lost(self, path: str | None) -> None:
        """Forget the activator that a lost connection led to; None: all connections are lost."""
        if path in (None, self._first):
            self._activator = None

    def led(self, lease: DroneLease, path: str) -> Led:
        """Note that a lease, sent over every connection, arrived over `path`."""
        return Led(path, (lease.activator_session, lease.nonce))
