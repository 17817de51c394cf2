"""`testbed links`: checks that the links of every profile are as configured. Network and nodes only; nothing flies.

For each profile the containers start and the links are calibrated as before a run. Links with random loss get enough
frames to measure it. The containers end, and the loss is read from the shaper's counters.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from net.link_plan import SHAPERS

from ..plan.documents import shown
from ..plan.experiments import PROTOCOLS
from ..plan.fleet import Fleet
from ..plan.profiles.reading import profile_names, read_profile
from ..plan.profiles.resolve import LinksPlan, resolve
from ..plan.topology import Topology
from ..plan.typed import one_of
from .calibration import Calibration, LinkLoss, calibrate, measure_losses
from .calibration.calibrate import RunInNode, run_schedule
from .calibration.schedule import make_load
from .calibration.table import HEAD, rows_of
from .containers import Containers, start_network
from .links import read_counters, read_shaper, write_plan
from .manifest import revision
from .progress import ConsoleProgress
from .results import live_attempt, point, write_json

VERSION = 1
EXPERIMENT = "links"
DOCUMENT = "links.json"


@dataclass(frozen=True)
class Checked:
    """The measurements of one profile's links."""

    plan: LinksPlan
    shaper: dict[str, Any]
    calibration: Calibration
    losses: tuple[LinkLoss, ...]
    void: str | None

    @property
    def off(self) -> tuple[str, ...]:
        """A line for each figure that is not as configured, and one if the shaper did not keep up."""
        lost = tuple(loss.off for loss in self.losses if loss.off is not None)
        return (*self.calibration.off, *lost, *((self.void,) if self.void is not None else ()))

    def to_data(self) -> dict[str, Any]:
        """The entry in links.json: calibration.json with each link's loss, the shaper and all that is off."""
        data = self.calibration.to_data()
        for loss in self.losses:
            data["links"][loss.link]["loss"] = loss.to_data()
        return {**data, "shaper": self.shaper, "void": self.void, "off": list(self.off)}


def check_profiles(
    names: str,
    shaper: str,
    fleet: Fleet,
    results: Path,
    console: Console,
    make_containers: Callable[..., Containers] = Containers,
) -> bool:
    """Check a fleet's links on a list of profiles (empty: all); prints configured and measured figures in a table.

    Returns whether all figures hold. Raises UserError for an unknown profile or shaper, DockerError if the containers
    cannot be started.
    """
    one_of("SHAPER", shaper, SHAPERS)
    topology = fleet.topology()
    wanted = [name.strip() for name in names.split(",") if name.strip()] or profile_names()
    plans = [resolve(read_profile(name), topology, EXPERIMENT, 1) for name in wanted]
    folder = _new_folder(results)
    progress = ConsoleProgress(console)
    found: list[Checked] = []
    for plan in plans:
        run_dir = live_attempt(folder / Path(plan.profile).stem, PROTOCOLS[0]).path
        write_plan(run_dir / "links", plan, topology, shaper)
        containers = make_containers(PROTOCOLS[0], run_dir, {}, fleet)
        found.append(_check(plan, topology, run_dir, containers, progress))
        write_json(folder / DOCUMENT, _document(found))
    _print(found, console)
    console.print(f"saved: {shown(folder / DOCUMENT)}", soft_wrap=True, markup=False)
    return not any(each.off for each in found)


def _check(
    plan: LinksPlan, topology: Topology, folder: Path, containers: Containers, progress: ConsoleProgress
) -> Checked:
    nodes = [node.name for node in topology.nodes]
    with _network(containers, nodes, f"{plan.profile}: network and nodes", progress) as run:
        said = read_shaper(folder / "links")
        with progress.phase(f"{plan.profile}: delay, jitter and rate"):
            calibration = calibrate(plan, topology, run)
        load = make_load(plan, topology, {})
        if load.flows:
            with progress.phase(f"{plan.profile}: {sum(flow.count for flow in load.flows)} frames, to see their loss"):
                run_schedule(load, run)
        containers.stop("net")
        counters = read_counters(folder / "links")
    shutil.rmtree(folder / "pcap")
    losses = measure_losses(replace(plan, events=()), counters)
    return Checked(plan, said, calibration, losses, counters["void"])


@contextmanager
def _network(containers: Containers, nodes: Sequence[str], what: str, progress: ConsoleProgress) -> Iterator[RunInNode]:
    """Run network and nodes as long as the context lasts. Raises TestbedError if the links cannot be shaped."""
    try:
        with progress.phase(what):
            containers.down()
            start_network(containers, nodes)
        yield containers.output
    finally:
        containers.down()


def _print(found: Sequence[Checked], console: Console) -> None:
    table = Table(*HEAD, box=None, pad_edge=False, header_style="bold")
    for checked in found:
        for row in rows_of(checked.plan.profile, checked.to_data()["links"]):
            table.add_row(*row)
    console.print("configured → measured; of each class the link that is furthest off")
    console.print(table)
    again = sum(len(each.calibration.again) for each in found)
    figures = [check for each in found for check in each.calibration.checks if check.note is None]
    judged = [loss for each in found for loss in each.losses if loss.note is None and loss.frames]
    off = [f"{each.plan.profile}: {line}" for each in found for line in each.off]
    for line in off:
        console.print(line, soft_wrap=True, markup=False)
    said = f"{len(off)} off" if off else "all within tolerance"
    probed = f"{len(figures)} figures probed, {again} of them again; {len(judged)} losses counted"
    console.print(f"{said}: {probed}", soft_wrap=True, markup=False)


def _document(found: Sequence[Checked]) -> dict[str, Any]:
    profiles = {each.plan.profile: each.to_data() for each in found}
    return {"version": VERSION, "revision": revision(), "profiles": profiles}


def _new_folder(results: Path) -> Path:
    """Make results/links/<utc>, and point `latest` to it. Raises OSError."""
    folder = results / EXPERIMENT / datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    folder.mkdir(parents=True)
    point(folder.parent / "latest", folder)
    return folder
