"""Whether the autopilot on the link is this drone's: known by its heartbeats, before anything is connected."""

from __future__ import annotations

PATIENCE_MS = 10_000
"""How long a heartbeat of another system, or of an unknown kind, has to keep coming to be of this link's autopilot."""
GAP_MS = 3000
"""Heartbeats that are further apart do not keep coming."""


class Recognition:
    """The heartbeats of flight controllers, until the own one's came.

    A stray one of another system, or of a kind that is not known, is no autopilot.
    """

    def __init__(self, system_id: int) -> None:
        self._system_id = system_id
        self._coming: dict[int, tuple[int, int]] = {}

    def on_own(self) -> None:
        """Something of the own system came: others that are heard share the link with it."""
        self._coming = {system: when for system, when in self._coming.items() if system == self._system_id}

    def on_heartbeat(self, system_id: int, now_ms: int, is_known: bool = True) -> int | None:
        """The heartbeat of a flight controller, `is_known`: of a kind that is known.

        Returns the system that this link belongs to, None where that is not clear.
        """
        if system_id == self._system_id and is_known:
            return system_id
        first_ms, last_ms = self._coming.get(system_id, (now_ms, now_ms))
        if now_ms - last_ms > GAP_MS:
            first_ms = now_ms
        self._coming[system_id] = (first_ms, now_ms)
        return system_id if now_ms - first_ms >= PATIENCE_MS else None
