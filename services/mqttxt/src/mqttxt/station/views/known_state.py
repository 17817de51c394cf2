"""A state with its age, as a user of the station reads it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from ...protocol.states import State

AState = TypeVar("AState", bound=State)

STALE_MS = 45_000
"""The age from which on programs show a value as stale: it was to be repeated (R3.5). No choice uses it (R7.3)."""


@dataclass(frozen=True)
class KnownState(Generic[AState]):
    """A state as it last arrived.

    Parameters:
        state: the value.
        age_ms: an upper bound of its age now, in milliseconds; None where the fog's clock is not known yet.
    """

    state: AState
    age_ms: int | None
