"""Which shaper: the emulator, or none where a plan asks for nothing."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from .run_plan import RunPlan


@dataclass(frozen=True)
class Choice:
    """`shaper` is nfqueue or none, and why."""

    shaper: str
    why: str

    def to_data(self) -> dict[str, Any]:
        """As shaper.json has it."""
        return asdict(self)


def choose(run: RunPlan) -> Choice:
    """What is to shape the links of a run."""
    if not run.is_shaped:
        return Choice("none", f"profile {run.plan.profile} shapes nothing")
    return Choice("nfqueue", "the plan asks for it")
