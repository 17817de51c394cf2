"""The losses of a cell's sides: over their completed attempts, or without any over the failed ones."""

from __future__ import annotations

from ...numbers import words
from ...numbers.quantities import COMMANDS_LOST, FRAMES_LOST, STATES_LOST
from ...numbers.quantity import Share
from .cells import Cell

QUANTITIES = (COMMANDS_LOST, STATES_LOST, FRAMES_LOST)
FAILED = "†"
"""Marks a loss over failed attempts, until they gave up."""


def both_sides(cell: Cell, quantity: Share) -> list[str]:
    """Both sides' losses, as '0 (< 0.44 %)' and '23 %'; with FAILED if a side completed no attempt."""
    said = []
    for side in cell.sides.values():
        found = quantity.together(side.completed or side.attempts).brief
        said.append(found if side.completed or found == words.NOTHING else f"{found}{FAILED}")
    return said
