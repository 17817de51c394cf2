"""Whether the autopilot on the link is this drone's, by its heartbeats, before the client connects to a broker."""

from __future__ import annotations

PATIENCE_MS = 10_000
"""How long heartbeats of another system, or an unknown kind, have to continue to count as this link's autopilot."""
GAP_MS = 3000
"""The longest gap between heartbeats that continue."""


class Recognition:
    """The heartbeats of flight controllers, until that of the drone's own.

    A stray heartbeat of another system, or of an unknown kind, does not count.
    """

    def __init__(self, system_id: int) -> None:
        self._system_id = system_id
        self._coming: dict[int, tuple[int, int]] = {}

    def on_own(self) -> None:
        """A message of the own system: other systems only share the link with it, and are forgotten."""
        self._coming = {system: when for system, when in self._coming.items() if system == self._system_id}

    def on_heartbeat(self, system_id: int, now_ms: int, is_known: bool = True) -> int | None:
        """Take in a flight controller's heartbeat; `is_known`: its kind is known.

        Returns the system id of the link's autopilot, None while that is not clear.
        """
        if system_id == self._system_id and is_known:
            return system_id
        first_ms, last_ms = self._coming.get(system_id, (now_ms, now_ms))
        if now_ms - last_ms > GAP_MS:
            first_ms = now_ms
        self._coming[system_id] = (first_ms, now_ms)
        return system_id if now_ms - first_ms >= PATIENCE_MS else None
