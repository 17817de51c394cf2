"""Estimates how long attempts take: as long as the attempts flown here, else the experiment's nominal time."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from statistics import median
from typing import Any

from ...errors import ResultsError
from ...plan.experiments import MESSAGES, Plan
from ..results import Attempt, attempt_of
from ..resume import amount_in, amount_of

NOMINAL_S = {
    "scenario-1": 80.0,
    "scenario-2": 150.0,
    "scenario-3": 65.0,
    "scenario-4": 190.0,
    "scenario-5": 260.0,
    MESSAGES: 60.0,
}
"""The time of an attempt, with starting and ending its fleet; one's own missions count as scenario 2."""
NOMINAL_MESSAGE_S = 18.0
"""The time of one message of each of the ten kinds."""
UPKEEP_S = 40.0
"""The time of starting and ending a fleet, for attempts that recorded only the time of their mission."""


class Durations:
    """How long the attempts of a results folder took, by experiment, protocol and number of samples or messages."""

    def __init__(self, root: Path) -> None:
        took: dict[tuple[str, str, str], list[float]] = defaultdict(list)
        for path in root.glob("*/*/*/*/attempt-*"):
            attempt = attempt_of(path)
            if attempt is None:
                continue
            try:
                manifest = attempt.manifest()
                seconds = _seconds(attempt, manifest)
            except ResultsError:
                continue
            if seconds is not None and manifest["status"] == "completed":
                took[(manifest["experiment"], attempt.protocol, amount_in(manifest["configuration"]))].append(seconds)
        self._middle = {key: median(values) for key, values in took.items()}

    def of(self, plan: Plan, protocol: str) -> float:
        """The seconds that an attempt takes."""
        known = self._middle.get((plan.experiment, protocol, amount_of(plan)))
        if known is not None:
            return known
        nominal = NOMINAL_S.get(plan.experiment, NOMINAL_S["scenario-2"])
        return nominal + (NOMINAL_MESSAGE_S * plan.count if plan.is_message_set else 0.0)


def _seconds(attempt: Attempt, manifest: dict[str, Any]) -> float | None:
    if "took_s" in manifest:
        return float(manifest["took_s"])
    events = attempt.events()
    return UPKEEP_S + (events[-1]["t_ns"] - events[0]["t_ns"]) / 1e9 if events else None


def in_words(seconds: float) -> str:
    """'about 2 h 40 min', 'about 5 min', 'less than a minute'."""
    minutes = round(seconds / 60)
    if minutes < 1:
        return "less than a minute"
    hours, rest = divmod(minutes if minutes < 60 else 10 * round(minutes / 10), 60)
    parts = [f"{hours} h"] * bool(hours) + [f"{rest} min"] * bool(rest)
    return f"about {' '.join(parts)}"
