"""An autopilot's verdict on arming, corrected after its receiver has lost its position (docs/protocol.md, R3.13)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Self

from ...protocol.states import Gps, GpsFix, Health, State

VERDICT_MS = 10_000
"""How long SYS_STATUS may take to show a lost fix: PX4 1.15 and main need 3.6 to 5.3 s."""


class LostFix:
    """Tracks when a receiver lost its 3D fix. For one that never had a fix the autopilot's verdict is unchanged."""

    def __init__(self) -> None:
        self._had = False
        self._lost_ms: int | None = None

    def __copy__(self) -> Self:
        twin = type(self)()
        twin._had, twin._lost_ms = self._had, self._lost_ms
        return twin

    def correct(self, told: Iterable[State], known: Health | None, now_ms: int) -> list[State]:
        """A message's states, without the verdict "armable" after a loss; `known` is the newest verdict."""
        return [corrected for state in told for corrected in self._correct(state, known, now_ms)]

    def _correct(self, state: State, known: Health | None, now_ms: int) -> list[State]:
        if isinstance(state, Health):
            is_outdated = self._lost_ms is not None and now_ms - self._lost_ms <= VERDICT_MS
            return [replace(state, armable=False) if is_outdated else state]
        if not isinstance(state, Gps):
            return [state]
        has = state.fix >= GpsFix.FIX_3D
        lost, self._had = self._had and not has, has
        if has:
            self._lost_ms = None
        elif lost:
            self._lost_ms = now_ms
            if known is not None:
                return [state, replace(known, armable=False)]
        return [state]
