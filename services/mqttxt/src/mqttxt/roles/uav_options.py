"""What one drone's UAV client is told about its drone."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import ConfigurationError

SHORTEST_S, LONGEST_S = 60, 86_400


@dataclass(frozen=True)
class UavOptions:
    """`endurance_s`: how long a full battery lasts in flight; None: to be measured.

    Raises ConfigurationError for what cannot be.
    """

    endurance_s: int | None = None

    def __post_init__(self) -> None:
        if self.endurance_s is not None and not SHORTEST_S <= self.endurance_s <= LONGEST_S:
            raise ConfigurationError(
                f"--endurance-s {self.endurance_s}: expected seconds from {SHORTEST_S} to {LONGEST_S}"
            )
