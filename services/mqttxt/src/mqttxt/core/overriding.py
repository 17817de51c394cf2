"""Which commands a later hold, land or return has overridden (docs/protocol.md, R7.6 and R10.1)."""

from __future__ import annotations

from typing import Final

from ..protocol.commands import Disarm, Pause
from .highest import Highest
from .ledger import FOG_CAPACITY, OVERRIDING

SAFETY = (*OVERRIDING, Disarm, Pause)
"""Commands that stop a drone: sent over every connection to it at once (R19.4), and repeated whatever follows them."""
_ANY: Final = -1


class LaterHolds:
    """The highest `seq` of a hold, land or return: of each sender, and of each sender to one drone or to all (None).

    A sender is a station's session at an activator, a fog at a station. The oldest are forgotten above the number of
    commands that a ledger remembers.
    """

    def __init__(self) -> None:
        self._highest = Highest[tuple[int, int | None]](FOG_CAPACITY)

    def note(self, sender: int, target: int | None, seq: int) -> None:
        """Note a hold, land or return to a drone, or to all drones."""
        for key in ((sender, _ANY), (sender, target)):
            self._highest.note(key, seq)

    def overrides_choice(self, sender: int, seq: int) -> bool:
        """Whether one of them is later than a choice of a drone, whichever drone it is for."""
        return seq < self._highest.of((sender, _ANY))

    def overrides(self, sender: int, target: int | None, seq: int) -> bool:
        """Whether one of them is later than a command to a drone, or to all, and for the same drones."""
        return seq < max(self._highest.of((sender, target)), self._highest.of((sender, None)))
