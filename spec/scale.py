"""The cost of more drones, from runs of whole roles: tables for docs/scale.md, and the data of its picture.

`python -m spec.scale FILE` writes them between their markers, from the runs that `python -m tests.bench load --write`
added to `load.json` and `cluster.json` in the folder beside it, from `prices.yaml` there, and from the bytes per hop in
docs/performance.md.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mqttxt.protocol.names import MAX_DRONE
from testbed.plan.documents import ROOT

from .flights import flights_table, read_flights
from .pages import pages
from .tables import filled, table

MOSQUITTO = "mosquitto"
RUNS = ROOT / "docs" / "scale" / "load.json"
ROLES = {"activators": "activators", "broker": "broker", "station": "station"}
SHOWN = {"drones": "UAV clients", **ROLES}
"""The roles shown for a run; the load of the UAV clients falls on the drones."""
STATES = 5
"""States per second of each drone, in every run."""
COMMANDS_EVERY_S = 10.0
"""The interval of the commands to each drone of the computed fleets, in seconds."""
BUSY = 0.5
"""The highest share of a core that a process with only one should use, so that commands do not wait."""
FLEETS = (250, 1000, 10_000, 1_000_000)
HOPS = ("drone to fog's broker", "activator to cloud's broker", "cloud's broker to a station")
MONTH_S = 30 * 86_400
_BYTES = r"^\| {} \| [\d,]+ \| ([\d,]+), ([\d,]+), ([\d,]+) \|"
MQTTXT, MAVLINK = "MQTT-XT, bundles", "MAVLink 2 over UDP"
"""Rows of the table in docs/performance.md."""
_BYTES_OF_DRONES = 6
"""The number of drones in the section "Bytes of a fleet" of docs/performance.md."""


@dataclass(frozen=True)
class Cost:
    """Cores that a role takes per fog, per drone with its five states per second, and per command per second."""

    per_fog: float
    per_drone: float
    per_command: float

    def cores(self, fogs: float, drones: float, commands_s: float) -> float:
        return self.per_fog * fogs + self.per_drone * drones + self.per_command * commands_s


@dataclass(frozen=True)
class Needs:
    """The needs of a number of drones: processes, cores by role, and bytes per second of all drones on each hop."""

    drones: int
    fogs: int
    brokers: int
    stations: int
    cores: dict[str, float]
    bytes_s: tuple[float, ...]


def read_runs(path: Path = RUNS) -> list[dict[str, Any]]:
    """The runs in their order."""
    runs: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return runs


def hops(page: str, row: str = MQTTXT) -> tuple[float, ...]:
    """Bytes per second of one drone on each hop, from a row in the text of docs/performance.md."""
    found = re.search(_BYTES.format(re.escape(row)), page, re.MULTILINE)
    assert found is not None, f"docs/performance.md: expected a row {row!r} with three hops"
    return tuple(int(hop.replace(",", "")) / _BYTES_OF_DRONES for hop in found.groups())


def costs(runs: Sequence[dict[str, Any]]) -> dict[str, Cost]:
    """Each role's cost by least squares over all runs, none of its three parts below zero.

    Of all subsets of the parts, the best-fitting one without a negative part counts; the other parts are zero.
    """
    factors = np.array([[run["fogs"], run["drones"], sum(run["words"].values()) / run["seconds"]] for run in runs])
    return {role: Cost(*_fitted(factors, np.array([run["shares"][role] for run in runs]))) for role in ROLES}


def _fitted(factors: Any, measured: Any) -> list[float]:
    best: tuple[float, list[float]] = (float("inf"), [0.0, 0.0, 0.0])
    for count in (1, 2, 3):
        for chosen in combinations(range(3), count):
            part, *_ = np.linalg.lstsq(factors[:, chosen], measured, rcond=None)
            error = float(np.sum((factors[:, chosen] @ part - measured) ** 2))
            if min(part) >= 0 and error < best[0]:
                found = [0.0, 0.0, 0.0]
                for place, value in zip(chosen, part, strict=True):
                    found[place] = float(value)
                best = error, found
    return best[1]


def needs(drones: int, cost: dict[str, Cost], apiece: Sequence[float]) -> Needs:
    """The needs of drones with a command each `COMMANDS_EVERY_S` seconds, at most `BUSY` of a core per process."""
    fogs = ceil(drones / MAX_DRONE)
    cores = {role: cost[role].cores(fogs, drones, drones / COMMANDS_EVERY_S) for role in ROLES}
    busy = {role: max(1, ceil(cores[role] / BUSY)) for role in ("broker", "station")}
    return Needs(drones, fogs, busy["broker"], busy["station"], cores, tuple(drones * hop for hop in apiece))


def runs_table(runs: Sequence[dict[str, Any]]) -> str:
    rows = []
    for run in runs:
        words = sum(run["words"].values())
        memory = ", ".join(f"{first:.0f} and {last:.0f}" for first, last in (run["rss_mb"][role] for role in SHOWN))
        rows.append(
            (
                f"{run['drones']:,} at {run['fogs']} in {run['fleets']}{_on(run)}",
                f"{run['seconds']:.0f} s",
                f"{words:,}: {run['lost']}, {run['late']}, {run['doubled']}",
                ", ".join(f"{count:,} {word}" for word, count in run["words"].items()),
                f"{_seconds(run.get('median_s'))}, {_seconds(run['slowest_s'])}",
                *(f"{100 * run['shares'][role]:.1f}" for role in SHOWN),
                memory,
            )
        )
    head = ("drones, fogs, fleets", "lasting", "commands: lost, late, doubled", "last words", "delay: median, slowest")
    return table(
        (
            *head,
            *(f"{name}, % of a core" for name in SHOWN.values()),
            f"MB of {', '.join(SHOWN.values())}, after a quarter and at the end",
        ),
        rows,
    )


def _on(run: dict[str, Any]) -> str:
    """The cloud's broker, unless it is one Mosquitto, as in the first runs, which do not name it."""
    cloud = run.get("cloud", MOSQUITTO)
    return "" if cloud == MOSQUITTO else f", {cloud}"


def _seconds(value: float | None) -> str:
    """A delay in ms or s; a dash for the medians missing in the first runs."""
    if value is None:
        return "–"
    return f"{1000 * value:.0f} ms" if value < 0.1 else f"{value:.2f} s"


def costs_table(cost: dict[str, Cost]) -> str:
    rows = [
        (name, *(f"{1000 * part:.2f}" for part in (of.per_fog, of.per_drone, of.per_drone / STATES, of.per_command)))
        for role, name in ROLES.items()
        for of in (cost[role],)
    ]
    return table(("ms of processor time", "a fog, per second", "a drone, per second", "a state", "a command"), rows)


def read_prices(path: Path) -> dict[str, dict[str, Any]]:
    """The prices by name, each with its dollars, unit and source."""
    prices: dict[str, dict[str, Any]] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return prices


def prices_list(prices: dict[str, dict[str, Any]]) -> str:
    return "\n".join(f"- {each['unit']}: ${each['dollars']} ({each['source']})." for each in prices.values())


def needs_table(found: Sequence[Needs], prices: dict[str, dict[str, Any]]) -> str:
    out_gb = [each.bytes_s[2] * MONTH_S / 1e9 for each in found]
    computing = [prices["core"]["dollars"] * sum(each.cores.values()) / BUSY for each in found]
    leaving = [prices["gigabyte"]["dollars"] * gigabytes for gigabytes in out_gb]
    apiece = [sum(both) / each.drones for *both, each in zip(computing, leaving, found, strict=True)]
    rows: list[tuple[str, ...]] = [
        ("fleets, and fogs of 250", *(f"{each.fogs:,}" for each in found)),
        *((f"cores of {name}", *(f"{each.cores[role]:,.1f}" for each in found)) for role, name in ROLES.items()),
        (f"brokers of at most {100 * BUSY:.0f} % of a core", *(f"{each.brokers:,}" for each in found)),
        (f"station processes of at most {100 * BUSY:.0f} %", *(f"{each.stations:,}" for each in found)),
        *(
            (f"{hop}, Mbit/s", *(f"{8 * each.bytes_s[place] / 1e6:,.1f}" for each in found))
            for place, hop in enumerate(HOPS)
        ),
        ("a drone's radio, GB a month", *(f"{each.bytes_s[0] / each.drones * MONTH_S / 1e9:,.2f}" for each in found)),
        ("from the cloud to one who hears all, TB a month", *(f"{gigabytes / 1000:,.2f}" for gigabytes in out_gb)),
        ("cores, half idle, $ a month", *(f"{dollars:,.0f}" for dollars in computing)),
        ("bytes out of the cloud, $ a month", *(f"{dollars:,.0f}" for dollars in leaving)),
        ("both, $ a month and drone", *(f"{dollars:,.2f}" for dollars in apiece)),
    ]
    return table(("drones", *(f"{each.drones:,}" for each in found)), rows)


def limits(cost: dict[str, Cost]) -> str:
    """The number of drones that load a process to `BUSY` of its one core."""
    lines = []
    for role in ("broker", "station"):
        each = cost[role].cores(1 / MAX_DRONE, 1, 1 / COMMANDS_EVERY_S)
        lines.append(f"- One {ROLES[role]} process: {BUSY / each:,.0f} drones.")
    return "\n".join(lines)


def goals(cost: dict[str, Cost]) -> str:
    """A thousand drones' cores by the fitted costs, beside the goals."""
    found = needs(1000, cost, ()).cores
    of_250 = 100 * found["activators"] * MAX_DRONE / 1000
    return (
        f"For 1,000 drones that is {of_250:.0f} % of a core of activators per {MAX_DRONE} drones (goal: at most 25 %), "
        f"and {100 * found['station']:.0f} % of a core for the station (goal: at most one core)."
    )


def cluster_goals(run: dict[str, Any]) -> str:
    """What a run on the cluster cost, beside the goals."""
    percent = {role: 100 * share for role, share in run["shares"].items()}
    return (
        f"For {run['drones']:,} drones in {run['fleets']} fleets the cluster takes {percent['broker']:.0f} % of a "
        f"core, activators {percent['activators'] * MAX_DRONE / run['drones']:.1f} % per {MAX_DRONE} drones (goal: at "
        f"most 25 %), and the station {percent['station']:.1f} % (goal: at most one core). With the UAV clients that "
        f"is {sum(percent[role] for role in SHOWN) / 100:.2f} cores, without the fogs' brokers. A command takes "
        f"{_seconds(run['median_s'])} in the median, and {_seconds(run['slowest_s'])} at most."
    )


def main(*files: str) -> None:
    """Write the tables into `files`."""
    of_page = pages(files, "load.json", "cluster.json", "prices.yaml", "flights.json")
    apiece = hops((ROOT / "docs" / "performance.md").read_text(encoding="utf-8"))
    for path in of_page:
        runs = read_runs(path.with_suffix("") / "load.json")
        prices = read_prices(path.with_suffix("") / "prices.yaml")
        cost, on_cluster = costs(runs), read_runs(path.with_suffix("") / "cluster.json")
        sections: dict[str, Callable[[], str]] = {
            "flights": partial(flights_table, read_flights(path.with_suffix("") / "flights.json")),
            "load-runs": partial(runs_table, runs),
            "load-cluster": partial(runs_table, on_cluster),
            "load-cluster-goals": partial(cluster_goals, max(on_cluster, key=lambda run: run["drones"])),
            "load-costs": partial(costs_table, cost),
            "load-needs": partial(needs_table, [needs(drones, cost, apiece) for drones in FLEETS], prices),
            "load-prices": partial(prices_list, prices),
            "load-goals": partial(goals, cost),
            "load-limits": partial(limits, cost),
        }
        path.write_text(filled(path.read_text(encoding="utf-8"), sections), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
