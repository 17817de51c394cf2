"""Recorded streams through real links of the testbed's topology: the shaper's counts beside the simulation's."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.resolve import LinksPlan
from tests.bench.fit_network import ShapedNetwork
from tests.bench.fit_search import SETTLED_NS, with_rates
from tests.bench.fit_simulation import DOWN, Crossed, Losses, Offered, losses, run
from tests.bench.fit_streams import ROOT, Frame, Streams
from tests.rigs.shaped_nodes import PYTHON, REPOSITORY

FOLDER = ROOT / ".cache" / "fit" / "replay"
SENDER = f"{REPOSITORY}/tests/bench/fit_sender.py"
LEAD_S = 2.0
SILENCE_S = 3.0
WAYS = ("air", "backhaul", "wan")


@dataclass(frozen=True)
class Replayed:
    """A replay beside a simulation of the frames at their actual times, at which a busy machine sent them.

    measured, expected  losses of frames sent once queues had filled
    counted             by the shaper's counters, from the first frame on: lost end to end, and over all links
    worked_out          the same, simulated
    planned             the same of the recording's own times
    late_ms             how late the latest frame was sent
    void                why the run does not count, by the shaper's counters
    """

    measured: Losses
    expected: Losses
    counted: tuple[float, float]
    worked_out: tuple[float, float]
    planned: tuple[float, float]
    late_ms: int
    void: str | None


def replay(made: ShapedNetwork, streams: Streams, plan: LinksPlan, air_bps: int, wan_bps: int) -> Replayed:
    """Send the streams from their drones to the ground station, on the plan's links with these rates."""
    rated = replace(plan, links=with_rates(plan.links, air_bps, wan_bps))
    with made.shaping(rated) as shaper, ThreadPoolExecutor(len(streams) + 1) as threads:
        listening = made.nodes["gs"].exec_run([PYTHON, SENDER, "receive", str(SILENCE_S)], stream=True).output
        assert next(listening).startswith(b"listening")
        receiving = threads.submit(b"".join, listening)
        begin_ns = time.monotonic_ns() + round(LEAD_S * 1e9)
        sending = {drone: threads.submit(_send, made, drone, streams[drone], begin_ns) for drone in streams}
        sent = {drone: future.result() for drone, future in sending.items()}
        come = json.loads(receiving.result())
    offered = Offered(sent, standard_fleet().fogs)
    crossed = run(offered, rated.links, plan.seed)
    numbers = {drone: come.get(made.address(f"uav{drone}"), []) for drone in streams}
    counters = shaper.counters()
    return Replayed(
        measured=losses(offered, _as_crossed(offered, crossed, numbers), SETTLED_NS),
        expected=losses(offered, crossed, SETTLED_NS),
        counted=_counted(counters["links"]),
        worked_out=_counted(_counters_of(crossed)),
        planned=_counted(_counters_of(run(Offered(streams, standard_fleet().fogs), rated.links, plan.seed))),
        late_ms=max(_late_ns(sent[drone], streams[drone]) for drone in streams) // 1_000_000,
        void=counters["void"],
    )


def _send(made: ShapedNetwork, drone: int, stream: tuple[Frame, ...], begin_ns: int) -> tuple[Frame, ...]:
    """Send a stream; returns it with its actual times."""
    file = f"uav{drone}.json"
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / file).write_text(json.dumps([frame[:2] for frame in stream]))
    inside = f"{REPOSITORY}/{FOLDER.relative_to(ROOT)}/{file}"
    said = made.output(f"uav{drone}", [PYTHON, SENDER, "send", inside, made.address("gs"), str(begin_ns)])
    return tuple(frame._replace(t_ns=t_ns) for frame, t_ns in zip(stream, json.loads(said), strict=True))


def _late_ns(sent: tuple[Frame, ...], planned: tuple[Frame, ...]) -> int:
    return max(one.t_ns - other.t_ns for one, other in zip(sent, planned, strict=True))


def _counted(links: Mapping[str, Mapping[str, int]]) -> tuple[float, float]:
    """Shares lost on the links up: of the frames that entered the air links, and of those that entered any link."""
    left: Counter[str] = Counter()
    lost: Counter[str] = Counter()
    for name, link in links.items():
        kind = name.partition(":")[0]
        if name == DOWN or (kind != "wan" and name.endswith(":up")):
            left[kind] += link["left"]
            lost[kind] += link["queue"] + link["random"]
    return 1 - left["wan"] / (left["air"] + lost["air"]), lost.total() / (left.total() + lost.total())


def _counters_of(crossed: Mapping[str, Crossed]) -> dict[str, dict[str, int]]:
    """A simulation's counters in the shaper's form, as far as they are needed."""
    return {
        name: {"left": len(link.left), "queue": link.queue, "random": link.random} for name, link in crossed.items()
    }


def _as_crossed(offered: Offered, crossed: Mapping[str, Crossed], come: Mapping[int, Any]) -> dict[str, Crossed]:
    """The simulation's links, with the frames that really arrived at the end of the last."""
    arrived = [offered.by_drone[drone][number] for drone, numbers in come.items() for number in numbers]
    return {**crossed, DOWN: replace(crossed[DOWN], left=arrived)}
