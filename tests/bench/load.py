"""A load of whole roles: fogs of drones at one cloud, five states per second of each in bundles, and commands to all.

Every drone is a real UAV client with a connection of its own, on a light autopilot (`load_drones`); every fog has its
activator, a process; one process is the station of all fleets (`load_station`). MAVLink has 250 ids, so that more
drones are several fleets, each below a prefix of its own. Everything is on this machine: one monotonic clock tells when
a command was sent, and when it was carried out.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from statistics import median
from typing import Any

from mqttxt.protocol.names import MAX_DRONE
from tests.bench.brokers import cpu_s, rss_mb
from tests.bench.clouds import CLOUDS, MOSQUITTO, STATION, Plan, Reached
from tests.bench.load_station import LAST_WORDS_S, REACHABLE_S, TTL_S
from tests.rigs.cluster import PORTS
from tests.rigs.processes import Process, eventually

SETTLING_S = 5.0
"""The pause before the measurement: all drones have become reachable at once."""
ENDING_S = 180.0
"""How long a process may take to end, after the last words: a thousand goodbyes take long on a full machine."""


@dataclass(frozen=True)
class Fogs:
    """`fogs` fogs of `drones` drones each, in fleets of as many as have ids, but at least in `fleets` of them."""

    fogs: int
    drones: int
    fleets: int = 1

    def plan(self) -> Plan:
        together = min(MAX_DRONE // self.drones, ceil(self.fogs / self.fleets))
        found = []
        for index in range(self.fogs):
            fleet, place = divmod(index, together)
            found.append((f"fleet{fleet + 1}/", index + 1, place * self.drones + 1, (place + 1) * self.drones))
        return found

    @property
    def count(self) -> int:
        return self.fogs * self.drones


@dataclass(frozen=True)
class Load:
    """The results of a run. Shares are of one core, memory is in megabytes: a quarter into the run, and at its end.

    `median_s` and `slowest_s` are from a call to the autopilot, `start_s` is from the start of all processes at once
    until all drones were controlled.
    """

    seconds: float
    words: Counter[str]
    lost: int
    doubled: int
    late: int
    median_s: float
    slowest_s: float
    oldest_s: float
    start_s: float
    shares: dict[str, float]
    rss_mb: dict[str, tuple[float, float]]

    @property
    def commands(self) -> int:
        return self.words.total()


def measure(
    fogs: int = 10,
    drones: int = 100,
    minutes: float = 0.5,
    every_s: float = 10.0,
    fleets: int = 1,
    write: Path | None = None,
    cloud: str = MOSQUITTO,
) -> list[str]:
    """Lines of figures; takes about a minute longer than `minutes`. With `write`, they are also added to that file.

    `cloud` is one of CLOUDS; the cluster carries ten fleets.
    """
    of = Fogs(fogs, drones, fleets)
    prefixes = {prefix for prefix, *_ in of.plan()}
    if cloud != MOSQUITTO and len(prefixes) > len(PORTS):
        raise SystemExit(f"--cloud {cloud}: {len(prefixes)} fleets; expected at most {len(PORTS)}")
    with tempfile.TemporaryDirectory() as folder:
        found = asyncio.run(run(Path(folder), of, 60 * minutes, every_s, cloud))
    if write is not None:
        runs = json.loads(write.read_text()) if write.exists() else []
        run_of = {"fogs": fogs, "drones": of.count, "fleets": len(prefixes)}
        runs.append(run_of | {"cloud": cloud, "every_s": every_s} | vars(found))
        write.write_text(json.dumps(runs, indent=1) + "\n")
    per_250 = found.shares["activators"] * MAX_DRONE / of.count
    memory = ", ".join(f"{name} {first:.0f} and {last:.0f}" for name, (first, last) in found.rss_mb.items())
    return [
        f"load: {of.count} drones at {fogs} fogs, 5 states a second each in bundles, {minutes:g} min: "
        f"{found.commands} commands, {found.lost} lost, {found.late} late, {found.doubled} doubled "
        f"({', '.join(f'{count} {word}' for word, count in found.words.most_common())}); from a call to the autopilot "
        f"{1000 * found.median_s:.0f} ms in the median, {1000 * found.slowest_s:.0f} ms at most; the oldest position "
        f"at the station {found.oldest_s:.1f} s; all drones controlled after {found.start_s:.0f} s",
        f"load: activators take {100 * per_250:.1f} % of a core per {MAX_DRONE} drones, the station "
        f"{100 * found.shares['station']:.0f} %, {cloud} {100 * found.shares['broker']:.0f} %, the UAV clients "
        f"{100 * found.shares['drones']:.0f} %; MB after a quarter and at the end: {memory}",
    ]


async def run(folder: Path, of: Fogs, lasting_s: float, every_s: float, cloud: str = MOSQUITTO) -> Load:
    """Start all, let them run, end them, and compare the commands sent with those carried out."""
    plan = of.plan()
    with ExitStack() as stack:
        broker = CLOUDS[cloud](folder, plan)
        stack.callback(broker.close)
        await asyncio.to_thread(broker.start)
        activators = [_activator(folder, broker.fleets[prefix], prefix, fog) for prefix, fog, _, _ in plan]
        fleets = [_drones(folder, reached.drone_url, prefix, plan) for prefix, reached in broker.fleets.items()]
        stations = {prefix: (reached.url, reached.identity(STATION)) for prefix, reached in broker.fleets.items()}
        arguments = [json.dumps(stations, default=str), json.dumps(plan), str(every_s), str(folder)]
        station = Process(folder, "station", "tests.bench.load_station", *arguments)
        started_s = time.monotonic()
        for process in (*activators, *fleets, station):
            stack.callback(process.start().kill)
        await eventually(lambda: station.ready_file.exists() or _ended(station, *activators), "ready", REACHABLE_S)
        assert not _ended(station, *activators), _ended(station, *activators)[0].log.read_text()[-2000:]
        start_s = time.monotonic() - started_s
        await asyncio.sleep(SETTLING_S)
        pids = {
            "activators": [process.pid for process in activators],
            "station": [station.pid],
            "drones": [process.pid for process in fleets],
        }

        def used_s() -> dict[str, float]:
            return {name: cpu_s(*own) for name, own in pids.items()} | {"broker": broker.cpu_s()}

        def memory_mb() -> dict[str, float]:
            return {name: sum(map(rss_mb, own)) for name, own in pids.items()} | {"broker": broker.rss_mb()}

        before_s, started_s = await asyncio.to_thread(used_s), time.monotonic()
        await asyncio.sleep(lasting_s / 4)
        early_mb = await asyncio.to_thread(memory_mb)
        await asyncio.sleep(lasting_s * 3 / 4)
        after_s, wall_s = await asyncio.to_thread(used_s), time.monotonic() - started_s
        shares = {name: (after_s[name] - before_s[name]) / wall_s for name in after_s}
        late_mb = await asyncio.to_thread(memory_mb)
        memory = {name: (early_mb[name], late_mb[name]) for name in late_mb}
        for processes in ([station], fleets):
            for process in processes:
                os.kill(process.pid, signal.SIGTERM)
            for process in processes:
                code = await asyncio.to_thread(process.wait, LAST_WORDS_S + ENDING_S)
                assert code == 0, process.log.read_text()[-2000:]
    return judged(folder, plan, wall_s, start_s, shares, memory)


def _ended(*processes: Process) -> list[Process]:
    return [process for process in processes if process.exit_code is not None]


def _root(prefix: str, fog: int) -> str:
    """The root of a fog's side, where no station listens."""
    return f"air/{prefix}fog{fog}/"


def _activator(folder: Path, reached: Reached, prefix: str, fog: int) -> Process:
    identity = reached.identity(f"fog{fog}")
    options = [
        *("--fog", str(fog)),
        *("--prefix", prefix),
        *("--cloud", reached.url),
        *("--fog-broker", reached.fog_url),
        *("--fog-root", _root(prefix, fog)),
        *(("--identity", str(identity)) if identity is not None else ()),
    ]
    return Process(folder, f"activator{fog}", "mqttxt", "activator", *options)


def _drones(folder: Path, url: str, prefix: str, plan: Plan) -> Process:
    own = [(_root(prefix, fog), first, last) for at, fog, first, last in plan if at == prefix]
    name = f"drones-{prefix.rstrip('/')}"
    return Process(folder, name, "tests.bench.load_drones", url, json.dumps(own), str(folder / f"{name}.json"))


def judged(
    folder: Path,
    plan: Plan,
    wall_s: float,
    start_s: float,
    shares: dict[str, float],
    memory: dict[str, tuple[float, float]],
) -> Load:
    """Evaluate the reports in a folder. A command carried out before any was sent counts as doubled."""
    said = json.loads((folder / "station.json").read_text())
    reports = [json.loads(path.read_text()) for path in folder.glob("drones-*.json")]
    failed = [error for report in reports for error in report["failed"]]
    assert failed == [], failed[:3]
    done: dict[str, list[Any]] = {name: times for report in reports for name, times in report["commanded"].items()}
    words: Counter[str] = Counter()
    lost, doubled, late = len(said["silent"]), 0, 0
    took_s: list[float] = []
    for prefix, fog, first, last in plan:
        for drone in range(first, last + 1):
            commands = said["commands"][f"{prefix}{fog}/{drone}"]
            times = [at_s for _, at_s in done[f"{_root(prefix, fog)}{drone}"]]
            starts = [sent_s for sent_s, _, _ in commands] + [float("inf")]
            doubled += sum(at_s < starts[0] for at_s in times)
            for (sent_s, word, reason), end_s in zip(commands, starts[1:], strict=True):
                own = [at_s for at_s in times if sent_s <= at_s < end_s]
                words[word if reason is None else f"{word}({reason})"] += 1
                lost += word == "unconfirmed" or (word == "completed" and not own)
                doubled += max(0, len(own) - 1)
                late += sum(at_s > sent_s + TTL_S for at_s in own)
                took_s += [at_s - sent_s for at_s in own]
    delays = (median(took_s), max(took_s)) if took_s else (0.0, 0.0)
    return Load(wall_s, words, lost, doubled, late, *delays, said["ages_s"][-1], start_s, shares, memory)
