"""Frames lost as the page counts them: without those that found a sensor's link closed, its drone being too far."""

from __future__ import annotations

from typing import Any


def lost(attempt: dict[str, Any]) -> int:
    """Frames that entered a link in the mission and did not leave it, though it was open to them."""
    all_lost: int = round((attempt["wire_loss"] or 0.0) * attempt["packets"])
    return max(0, all_lost - int(attempt.get("out_of_range", 0)))


def entered(attempt: dict[str, Any]) -> int:
    """Of how many."""
    return int(attempt["packets"]) - int(attempt.get("out_of_range", 0))


def share_lost(attempt: dict[str, Any]) -> float | None:
    """The quotient; None where nothing was counted."""
    of = entered(attempt)
    return None if attempt["wire_loss"] is None else lost(attempt) / of if of else None
