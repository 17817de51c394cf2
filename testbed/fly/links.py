"""The links of an attempt: what `net` gets of them before a run, and what it counts in it.

Everything is in the attempt's folder `links/`: plan.json and calibration.json (what probes measured) are written here;
shaper.json (what shapes), counters.json (what each link did) and events.jsonl (what changed, and when) are `net`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from net.link_plan import Gate

from ..plan.experiments import Plan
from ..plan.profiles.resolve import LinksPlan, resolve
from ..plan.profiles.run_plan import run_plan
from ..plan.topology import Topology
from .calibration import Calibration, Loss, measure_losses
from .results import (
    LINKS_CALIBRATION,
    LINKS_COUNTERS,
    LINKS_EVENTS,
    LINKS_PLAN,
    LINKS_SHAPER,
    LINKS_START,
    read_json,
    read_json_lines,
    write_json,
)


def plan_links(plan: Plan, number: int) -> LinksPlan:
    """What every link does in an attempt: drawn from experiment and attempt, the same for every protocol."""
    return resolve(plan.profile, plan.topology, plan.experiment, number)


def write_plan(
    folder: Path,
    links: LinksPlan,
    topology: Topology,
    shaper: str,
    *,
    always: bool = False,
    gates: Sequence[Gate] = (),
) -> None:
    """Write the plan for `net`; with `always` it shapes every link, also those on which nothing is planned."""
    write_json(folder / LINKS_PLAN, run_plan(links, topology, shaper=shaper, always=always, gates=gates))


def start_clock(folder: Path) -> None:
    """Let the time of the plan's events begin; in a run the mission does so itself."""
    (folder / LINKS_START).touch()


def read_shaper(folder: Path) -> dict[str, Any]:
    """What shapes the links and why that, as `net` says once all are shaped. Raises ResultsError."""
    return read_json(folder / LINKS_SHAPER)


def write_calibration(folder: Path, calibration: Calibration) -> dict[str, Any]:
    """Keep what the probes measured; returns it as it is kept."""
    found = calibration.to_data()
    write_json(folder / LINKS_CALIBRATION, found)
    return found


def off_lines(folder: Path, links: LinksPlan) -> tuple[str, ...]:
    """How the links of a flight differed from its plan, a line each; empty when they did not, or none was shaped.

    The shaper kept up, and what it lost at random is what the plan says, as far as chance allows; it is kept beside
    what the probes measured. Raises ResultsError where a file that has it is missing or damaged.
    """
    if read_shaper(folder)["shaper"] == "none":
        return ()
    counters = read_counters(folder)
    changes = read_json_lines(folder / LINKS_EVENTS, frozenset({"t_ns"}))
    by_hand = {event["link"] for event in changes if event.get("cause") == "hand"}
    losses = measure_losses(links, counters, by_hand)
    _keep_losses(folder, losses)
    lines = (counters["void"], *(loss.off for loss in losses))
    return tuple(line for line in lines if line is not None)


def _keep_losses(folder: Path, losses: Sequence[Loss]) -> None:
    found = read_json(folder / LINKS_CALIBRATION)
    for loss in losses:
        found["links"].setdefault(loss.link, {})["loss"] = loss.to_data()
    write_json(folder / LINKS_CALIBRATION, found)


def read_counters(folder: Path) -> dict[str, Any]:
    """What each link did, by the shaper's own count. Raises ResultsError."""
    return read_json(folder / LINKS_COUNTERS)
