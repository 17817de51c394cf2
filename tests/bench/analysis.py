"""Speed of the analysis: frames per CPU second of the packets table beside full dissection by scapy, in one run.

The attempt is the newest one flown over MAVLink, else one made here: six drones with PX4's onboard streams.
"""

from __future__ import annotations

import itertools
import multiprocessing
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scapy.layers.l2 import Ether
from scapy.utils import RawPcapReader

from testbed.fly.observations import verdict_of
from testbed.fly.results import Attempt, Series
from testbed.numbers.dissect import mavlink, mqtt5
from testbed.numbers.metrics.attempt import measure_attempt
from testbed.numbers.packets.build import build
from testbed.numbers.packets.table import load
from testbed.plan.documents import ROOT

MADE_S = 10
"""Duration in seconds of the attempt that is made if none was flown."""
DISSECTED = 3000
"""Frames that scapy dissects; more would only take longer."""
_MIB = 1024


@dataclass(frozen=True)
class Analysed:
    """The cost of analysing an attempt, in a process of its own.

    `records` counts the captures' frames, both sides of each link. `memory_mib` is the process's largest memory,
    `idle_mib` its memory with everything imported.
    """

    records: int
    frames: int
    attempt_s: float
    table_cpu_s: float
    table_s: float
    metrics_s: float
    idle_mib: float
    memory_mib: float


def measure() -> list[str]:
    """Lines of figures; takes about 20 s."""
    with tempfile.TemporaryDirectory() as name:
        flown = newest_flown()
        attempt = flown if flown is not None else make_attempt(Path(name))
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            found = pool.submit(analyse, attempt).result()
            plain, full = (pool.submit(dissected_per_cpu_s, attempt, bound).result() for bound in (False, True))
    table = found.records / found.table_cpu_s
    share = (found.table_s + found.metrics_s) / found.attempt_s
    return [
        f"analysis of {'a flown' if flown is not None else 'a made'} MAVLink attempt of {found.attempt_s:.1f} s: "
        f"{found.records:,} frames in the captures, {found.frames:,} on links",
        f"  packets table: {table:,.0f} frames a CPU second; scapy with MAVLink's fields {full:,.0f}, "
        f"up to UDP {plain:,.0f}",
        f"  the table is {table / full:.0f} times as fast as full dissection (goal: 10 or more)",
        f"  table {found.table_s:.2f} s and metrics {found.metrics_s:.2f} s: {100 * share:.1f} % of the attempt's time",
        f"  most memory: {found.memory_mib:.0f} MiB, of which {found.idle_mib:.0f} MiB before the first frame",
    ]


def newest_flown(results: Path = ROOT / "results") -> Attempt | None:
    """The newest attempt over MAVLink with captures, None without one."""
    folders = [path.parent for path in results.glob("*/*/*/mavlink/attempt-*/pcap") if any(path.glob("*.pcap"))]
    newest = max(folders, key=lambda path: path.parents[1].name, default=None)
    return Attempt(newest, "mavlink", int(newest.name.removeprefix("attempt-"))) if newest is not None else None


def make_attempt(folder: Path) -> Attempt:
    """Six drones stream through a chain of routers; the ground station arms them one by one."""
    from tests.handmade.mavlink_attempts import (
        ONBOARD_HZ,
        SECOND,
        T0,
        Chain,
        fill_streams,
        long_command,
        make_mavlink_attempt,
        packed,
        sender,
    )

    chain = Chain((1, 2, 3, 4, 5, 6))
    fill_streams(chain, MADE_S, ONBOARD_HZ)
    station = sender(245, 190)
    events: list[dict[str, Any]] = []
    for drone in chain.drones:
        t_ns = T0 + drone * SECOND // 100
        asked = {"event": "command", "call": drone, "command": "arm", "fog": None, "drone": drone}
        events.append({"t_ns": t_ns - 1000, **asked})
        chain.send(t_ns, packed(station, long_command(400, drone, 1.0)), drone, up=False)
    ended = {"event": "mission_end", "status": "completed", "reason": None}
    events.append({"t_ns": T0 + MADE_S * SECOND, **ended})
    return make_mavlink_attempt(Series(folder), 1, chain, events, disarmed_s=MADE_S)


def analyse(attempt: Attempt) -> Analysed:
    """Make the table anew, then the metrics from it; run this in a process of its own."""
    idle = _most_kib()
    cpu, wall = time.process_time(), time.perf_counter()
    built = build(attempt)
    table_cpu_s, table_s = time.process_time() - cpu, time.perf_counter() - wall
    on_links = built.rows.filter(built.rows["link"].is_not_null())
    records = len(built.rows) + built.unmatched + int(on_links["left_ns"].is_not_null().sum())
    attempt_s = (on_links["t_ns"][-1] - on_links["t_ns"][0]) / 1e9
    frames = len(on_links)
    del built, on_links
    load(attempt)  # the metrics' input is cached from here on
    wall = time.perf_counter()
    manifest = attempt.manifest()
    measure_attempt(attempt, manifest, verdict_of(attempt, manifest))
    metrics_s = time.perf_counter() - wall
    return Analysed(records, frames, attempt_s, table_cpu_s, table_s, metrics_s, idle / _MIB, _most_kib() / _MIB)


def dissected_per_cpu_s(attempt: Attempt, bound: bool) -> float:
    """Frames that scapy dissects per CPU second, with the testbed's layers or without; reading is not counted."""
    if bound:
        mavlink.bind()
        mqtt5.bind()
    path = max((attempt.path / "pcap").glob("*.pcap"), key=lambda path: path.stat().st_size)
    with RawPcapReader(str(path)) as reader:
        frames = [data for data, _ in itertools.islice(reader, 2 * DISSECTED)]
    for data in frames[:DISSECTED]:  # classes of messages are made at their first use
        Ether(data)
    cpu = time.process_time()
    for data in frames[DISSECTED:]:
        Ether(data)
    return (len(frames) - DISSECTED) / (time.process_time() - cpu)


def _most_kib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
