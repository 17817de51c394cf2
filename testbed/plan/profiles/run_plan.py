"""`plan.json`: a run's links for the container `net`, written before anything runs on the nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from net.link_plan import RUN_VERSION, Gate

from ..topology import Topology
from .kernel import commands_of
from .resolve import LinksPlan


def run_plan(
    plan: LinksPlan, topology: Topology, *, shaper: str = "auto", always: bool = False, gates: Sequence[Gate] = ()
) -> dict[str, Any]:
    """The file's content.

    `shaper` is one of SHAPERS; `always` shapes every link, also one without planned figures, so that it can be changed
    by hand during the run. A gate's link has no direction, as `sense:uav1`.
    """
    return {
        "version": RUN_VERSION,
        "shaper": shaper,
        "always": always,
        "plan": plan.to_data(),
        "kernel": commands_of(plan, topology, always=always or bool(gates)).to_data(),
        "gates": [asdict(gate) for gate in gates],
    }
