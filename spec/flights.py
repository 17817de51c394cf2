"""The cost of fleets of different sizes in flight, over both protocols: a table for docs/scale.md, and its picture.

`python -m spec.flights FOLDER…` reads series of one scenario, arm and profile, and writes docs/scale/flights.json.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from statistics import fmean, median
from typing import Any

from testbed.errors import ResultsError
from testbed.plan.documents import ROOT
from testbed.plan.wording import PROTOCOL_NAMES

from .pages import metrics_of
from .svg import Drawing
from .tables import table

FLIGHTS = ROOT / "docs" / "scale" / "flights.json"
CLOUD, FOG = ("broker", "router-cloud"), ("activator", "router-fog")
"""Prefixes of the names of relaying containers, in the cloud and at a fog, for both protocols."""
_EDGE = 2
"""Seconds left out at each end of a mission: the first includes earlier traffic, the last may be incomplete."""


@dataclass(frozen=True)
class Flight:
    """One attempt: rates in bytes per second, processor time in seconds, delays of commands on links in ms.

    `total` is TotalLoad, the traffic on the air links of all fogs (equation 2 of the thesis); `wan` is the traffic
    between station and cloud.
    """

    protocol: str
    fogs: int
    drones: int
    status: str
    total: float
    wan: float
    cloud_s: float
    fog_s: float
    delay_ms: float
    slowest_ms: float

    @property
    def of_fog(self) -> float:
        """L(x), the mean of all fogs x (equation 1 of the thesis)."""
        return self.total / self.fogs


def read_flights(path: Path = FLIGHTS) -> list[Flight]:
    """The flights, ordered by drones, then fogs."""
    return [Flight(**each) for each in json.loads(path.read_text(encoding="utf-8"))]


def flight(protocol: str, entry: Mapping[str, Any]) -> Flight:
    """The flight of an attempt in metrics.json; raises ResultsError if it is too short or has no command."""
    fogs = {name: drones for name, drones in entry["load"].items() if name != "total"}
    delays = list(chain.from_iterable(entry["delay_ms"].values()))
    if len(entry["load"]["total"]) <= 2 * _EDGE or not delays:
        raise ResultsError(f"{protocol}, attempt {entry['attempt']}: expected a mission with commands")
    return Flight(
        protocol,
        len(fogs),
        sum(map(len, fogs.values())),
        entry["status"],
        round(fmean(entry["load"]["total"][_EDGE:-_EDGE]), 1),
        round(fmean(entry["traffic"]["wan"][_EDGE:-_EDGE]), 1),
        round(_processor_s(entry, CLOUD), 2),
        round(_processor_s(entry, FOG), 2),
        round(median(delays), 3),
        round(max(delays), 3),
    )


def _processor_s(entry: Mapping[str, Any], roles: tuple[str, ...]) -> float:
    used: Mapping[str, float] = entry["cpu_s"]
    return sum(seconds for name, seconds in used.items() if name.startswith(roles))


def flights_table(flights: Sequence[Flight]) -> str:
    """One row per fleet, MQTT-XT's figure before MAVLink's."""
    shown: tuple[Callable[[Flight], str], ...] = (
        lambda one: one.status,
        lambda one: f"{8 * one.of_fog / 1000:.1f}",
        lambda one: f"{8 * one.total / 1000:.1f}",
        lambda one: f"{8 * one.wan / 1000:.1f}",
        lambda one: f"{one.fog_s:.1f}",
        lambda one: f"{one.cloud_s:.1f}",
        lambda one: f"{one.delay_ms:.1f}",
        lambda one: f"{one.slowest_ms:.0f}",
    )
    fleets: dict[tuple[int, int], dict[str, Flight]] = {}
    for one in flights:
        fleets.setdefault((one.drones, one.fogs), {})[one.protocol] = one
    rows = [
        (f"{drones} at {fogs}", *(" / ".join(show(of[p]) for p in PROTOCOL_NAMES if p in of) for show in shown))
        for (drones, fogs), of in sorted(fleets.items())
    ]
    head = ("drones at fogs", "mission", "load of a fog, L(x)", "all fogs, TotalLoad", "station to cloud")
    return table((*head, "CPU s, fogs", "CPU s, cloud", "command, ms: median", "slowest"), rows)


_LEFT, _RIGHT, _TOP, _BOTTOM, _APART, _DOT = 60, 320, 50, 300, 350, 4
_PANELS: tuple[tuple[str, Callable[[Flight], float]], ...] = (
    ("all fogs, TotalLoad: kbit per second", lambda one: 8 * one.total / 1000),
    ("station to cloud: kbit per second", lambda one: 8 * one.wan / 1000),
    ("a command on its links: ms, median", lambda one: one.delay_ms),
)


def draw(flights: Sequence[Flight]) -> Drawing:
    """Draw three panels with drones on the x axis and all axes from zero; fleets of equal size differ in their fogs."""
    drawing = Drawing(len(_PANELS) * _APART, 350, "Flights against drones")
    most = max(one.drones for one in flights)
    for place, (title, value) in enumerate(_PANELS):
        left, highest = place * _APART, max(map(value, flights))
        drawing.text(left + _LEFT, _TOP - 20, title, "title")
        drawing.line((left + _LEFT, _BOTTOM), (left + _RIGHT, _BOTTOM))
        drawing.line((left + _LEFT, _TOP), (left + _LEFT, _BOTTOM))
        for drones in sorted({one.drones for one in flights}):
            drawing.text(left + _LEFT + (_RIGHT - _LEFT) * drones / most, _BOTTOM + 18, str(drones), "small", "middle")
        for share in (0, 0.5, 1):
            at = _BOTTOM - (_BOTTOM - _TOP) * share
            drawing.text(left + _LEFT - 6, at + 4, f"{share * highest:,.0f}", "small", "end")
        for one in flights:
            x = left + _LEFT + (_RIGHT - _LEFT) * one.drones / most
            y = _BOTTOM - (_BOTTOM - _TOP) * value(one) / highest
            drawing.text(x, y + _DOT, "●", f"{one.protocol} small", "middle")
    drawing.text(_LEFT, _BOTTOM + 36, "drones", "small")
    for place, (protocol, name) in enumerate(PROTOCOL_NAMES.items()):
        drawing.text(_LEFT + 70 + 90 * place, _BOTTOM + 36, f"● {name}", protocol)
    return drawing


def main(*folders: str) -> None:
    """Write all attempts of the series that count."""
    found = []
    for path in metrics_of(folders):
        metrics = json.loads(path.read_text(encoding="utf-8"))
        for protocol, entry in metrics["protocols"].items():
            found += [flight(protocol, attempt) for attempt in entry["attempts"]]
    found.sort(key=lambda one: (one.drones, one.fogs, one.protocol))
    FLIGHTS.write_text(json.dumps([asdict(one) for one in found], indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
