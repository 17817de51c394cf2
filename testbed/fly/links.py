"""The links of an attempt: the plan that `net` gets before a run, and its counts afterwards.

All files are in the attempt's folder `links/`. This module writes plan.json and calibration.json (the measurements of
the probes). `net` writes shaper.json (the shaper), counters.json (the counts of each link) and events.jsonl (changes
of links, with times).
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
from .calibration import Calibration, LinkLoss, measure_losses
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
    """Plan every link of an attempt for as long as its mission may take.

    It is drawn from experiment and attempt, the same for both protocols.
    """
    return resolve(plan.profile, plan.topology, plan.experiment, number, plan.limit_s)


def write_plan(
    folder: Path,
    links: LinksPlan,
    topology: Topology,
    shaper: str,
    *,
    always: bool = False,
    gates: Sequence[Gate] = (),
) -> None:
    """Write the plan for `net`; with `always` it shapes every link, also those without planned figures."""
    write_json(folder / LINKS_PLAN, run_plan(links, topology, shaper=shaper, always=always, gates=gates))


def start_clock(folder: Path) -> None:
    """Start the clock of the plan's events; in a run the mission does that."""
    (folder / LINKS_START).touch()


def read_shaper(folder: Path) -> dict[str, Any]:
    """The shaper and why it was taken, as `net` reports once all links are shaped. Raises ResultsError."""
    return read_json(folder / LINKS_SHAPER)


def write_calibration(folder: Path, calibration: Calibration) -> dict[str, Any]:
    """Write the measurements of the probes; returns the document."""
    found = calibration.to_data()
    write_json(folder / LINKS_CALIBRATION, found)
    return found


def off_lines(folder: Path, links: LinksPlan) -> tuple[str, ...]:
    """How the links of a flight differed from its plan, a line each; empty if they did not, or if none was shaped.

    Checks that the shaper kept up, and that its random losses are as planned, as far as chance allows. The losses are
    added to calibration.json. Raises ResultsError if a needed file is missing or damaged.
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


def _keep_losses(folder: Path, losses: Sequence[LinkLoss]) -> None:
    found = read_json(folder / LINKS_CALIBRATION)
    for loss in losses:
        found["links"].setdefault(loss.link, {})["loss"] = loss.to_data()
    write_json(folder / LINKS_CALIBRATION, found)


def read_counters(folder: Path) -> dict[str, Any]:
    """The shaper's own counts of each link. Raises ResultsError."""
    return read_json(folder / LINKS_COUNTERS)
