"""Probes the idle links of a run and compares the measurements with the plan."""

from __future__ import annotations

import json
import math
import random
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from net.link_plan import SLOT_JITTERS, LinkPlan

from ...errors import FleetError, ProbesLate
from ...plan.profiles.resolve import LinksPlan
from ...plan.profiles.units import show_rate
from ...plan.topology import Topology
from . import estimate
from .estimate import ArrivedProbe
from .expected import VALUES_A_SLOT, ExpectedDelays, Interval, arriving, rate_bps
from .schedule import DELAY, RATE, CalibrationFlow, CalibrationSchedule, make_schedule

VERSION = 1
FIGURES = ("delay_ms", "jitter_ms", "rate_bps")
COMMAND = ["/opt/venv/bin/python", "-m", "net.probe"]
LEAD_S = 2.0
"""From starting the probes to sending the first one; doubled if one began too late."""
STARTS = 3
ROUNDS = 3
"""A figure that is off is probed again; only one that is off three times counts as off. A right one is in 1 of 1e9."""
RUN_BITS = 31
"""Bits of a run's number, which begins each probe, so that none looks like MAVLink (markers 0xfd and 0xfe)."""
_MS = 1e-3
RunInNode = Callable[[str, list[str]], str]


@dataclass(frozen=True)
class Check:
    """One figure of a directed link, configured and measured; `note` says why it is not probed."""

    link: str
    figure: str
    """delay_ms, jitter_ms or rate_bps"""
    configured: float | None
    measured: float | None = None
    lowest: float | None = None
    highest: float | None = None
    arrived: int = 0
    sent: int = 0
    missed: int = 0
    """Frames of any link that the probe at this link's end did not read in time."""
    note: str | None = None
    more: Mapping[str, float] = field(default_factory=dict)

    @property
    def off(self) -> str | None:
        """Why the figure is not as configured, in one line; None if it is, or if it was not probed."""
        if self.lowest is None or self.highest is None or self.note is not None:
            return None
        if self.measured is not None and self.lowest <= self.measured <= self.highest:
            return None
        name = self.figure.partition("_")[0]
        measured = "nothing" if self.measured is None else _shown(self.figure, self.measured)
        missed = f", its node missed {self.missed}" if self.missed else ""
        lowest = max(0.0, self.lowest)
        return (
            f"{self.link} {name}: configured {_shown(self.figure, self.configured or 0.0)}, measured {measured} "
            f"({self.arrived} of {self.sent} probes arrived{missed}); "
            f"expected {_shown(self.figure, lowest)} to {_shown(self.figure, self.highest)}"
        )

    def to_data(self) -> dict[str, Any]:
        """The entry in calibration.json."""
        if self.note is not None:
            return {"configured": self.configured, "measured": None, "note": self.note}
        figures = {"configured": self.configured, "measured": self.measured, "lowest": self.lowest}
        return {**figures, "highest": self.highest, "arrived": self.arrived, "sent": self.sent, **self.more}


@dataclass(frozen=True)
class Calibration:
    """Every figure of every directed link, by the last round that probed it; `again` says why any were probed again."""

    profile: str
    checks: tuple[Check, ...]
    rounds: int
    took_s: float
    again: tuple[str, ...] = ()

    @property
    def off(self) -> tuple[str, ...]:
        """One line for each figure that is not as configured."""
        return tuple(check.off for check in self.checks if check.off is not None)

    def to_data(self) -> dict[str, Any]:
        """The document calibration.json."""
        links: dict[str, dict[str, Any]] = {}
        for check in self.checks:
            links.setdefault(check.link, {})[check.figure] = check.to_data()
        head = {"version": VERSION, "profile": self.profile, "rounds": self.rounds, "took_s": round(self.took_s, 3)}
        return {**head, "links": links, "off": list(self.off), "again": list(self.again)}


def calibrate(
    plan: LinksPlan,
    topology: Topology,
    run_in_node: RunInNode,
    closed: Mapping[str, str] | None = None,
    ahead_ns: Mapping[str, int] | None = None,
) -> Calibration:
    """Probe every idle link, before any event: takes about 3 to 11 s, longer for very slow links.

    `run_in_node(node, command)` runs a command on a node and returns its output; it is called from threads, one per
    node at a time. `closed` has the reasons of links, as sense:uav1, that pass nothing now. `ahead_ns` is by node how
    far its clock is ahead. Raises FleetError if a probe cannot be run or does not begin in time (ProbesLate).
    """
    began_s = time.monotonic()
    checks: dict[tuple[str, str], Check] = {}
    only, rounds = frozenset(plan.links), 0
    off: tuple[str, ...] = ()
    again: tuple[str, ...] = ()
    while only and rounds < ROUNDS:
        schedule = make_schedule(plan, topology, closed or {}, only, rounds)
        arrived = run_schedule(schedule, run_in_node, ahead_ns)
        rounds, again = rounds + 1, again + off
        for check in checks_of(plan, schedule, arrived, only):
            checks[check.link, check.figure] = check
        only = frozenset(check.link for check in checks.values() if check.off is not None)
        off = tuple(check.off for check in checks.values() if check.off is not None)
    ordered = [checks[name, figure] for name in plan.links for figure in FIGURES if (name, figure) in checks]
    return Calibration(plan.profile, tuple(ordered), rounds, time.monotonic() - began_s, again)


@dataclass(frozen=True)
class FlowResult:
    """The result of one flow: probes sent, those that arrived, each once, and how many frames their node missed."""

    sent: int
    rows: tuple[ArrivedProbe, ...]
    missed: int = 0

    @property
    def counts(self) -> tuple[int, int, int]:
        """Arrived, sent, missed."""
        return len(self.rows), self.sent, self.missed


def run_schedule(
    schedule: CalibrationSchedule, run_in_node: RunInNode, ahead_ns: Mapping[str, int] | None = None
) -> dict[int, FlowResult]:
    """Carry out a schedule on its nodes; returns the arrivals by flow. `ahead_ns` as in `calibrate`.

    Raises FleetError, or its subclass ProbesLate if a probe began too late each time.
    """
    if not schedule.flows:
        return {}
    lead_s = LEAD_S
    for _ in range(STARTS):
        said = _run_once(schedule, run_in_node, lead_s, ahead_ns or {})
        late = {node: answer["late_ms"] for node, answer in said.items() if answer["late_ms"] > 0}
        if not late:
            return _arrivals(schedule, said, ahead_ns or {})
        lead_s *= 2
    node = max(late, key=lambda name: float(late[name]))
    raise ProbesLate(
        f"{node}: the probe began {late[node]:.0f} ms late, {lead_s / 2:g} s after it was asked for; "
        "expected a machine that is less busy"
    )


def _run_once(
    schedule: CalibrationSchedule, run_in_node: RunInNode, lead_s: float, ahead_ns: Mapping[str, int]
) -> dict[str, dict[str, Any]]:
    run = random.SystemRandom().getrandbits(RUN_BITS)
    begin_ns = time.time_ns() + int(lead_s * 1e9)

    def ask(node: str) -> dict[str, Any]:
        text = json.dumps(schedule.of_node(node, run, begin_ns + ahead_ns.get(node, 0)), separators=(",", ":"))
        said = run_in_node(node, [*COMMAND, text])
        try:
            found = json.loads(said)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            lines = said.strip().splitlines()
            raise FleetError(f"{node}: the probe of its links said: {lines[-1] if lines else 'nothing'}")
        return found

    with ThreadPoolExecutor(len(schedule.nodes)) as pool:
        return dict(zip(schedule.nodes, pool.map(ask, schedule.nodes), strict=True))


def _arrivals(
    schedule: CalibrationSchedule, said: Mapping[str, Mapping[str, Any]], ahead_ns: Mapping[str, int]
) -> dict[int, FlowResult]:
    found = {}
    for flow in schedule.flows:
        there, number = said[flow.destination], str(flow.number)
        came = there["arrived"].get(number, {"rows": []})["rows"]
        late_ns = ahead_ns.get(flow.destination, 0) - ahead_ns.get(flow.source, 0)
        rows = estimate.first_copies(
            ArrivedProbe(row, sent_ns + late_ns, received_ns) for row, sent_ns, received_ns in came
        )
        found[flow.number] = FlowResult(said[flow.source]["sent"].get(number, 0), tuple(rows), there["overflowed"])
    return found


def checks_of(
    plan: LinksPlan, schedule: CalibrationSchedule, arrived: Mapping[int, FlowResult], only: Iterable[str]
) -> list[Check]:
    """Check every figure of the links in `only`."""
    flows = {(flow.link, flow.purpose): flow for flow in schedule.flows}
    found: list[Check] = []
    for name in plan.links:
        if name not in only:
            continue
        link = plan.links[name]
        why = schedule.unprobed.get((name, DELAY))
        if why is not None:
            configured = {"delay_ms": link.delay_us * _MS, "jitter_ms": link.jitter_us * _MS}
            found += [Check(name, figure, value, note=why) for figure, value in configured.items()]
        else:
            flow = flows[name, DELAY]
            found += _delay_checks(link, flow, arrived[flow.number])
        why = schedule.unprobed.get((name, RATE))
        if why is not None:
            found.append(Check(name, "rate_bps", link.rate_bps, note=why))
        else:
            flow = flows[name, RATE]
            found.append(_rate_check(link, flow, arrived[flow.number]))
    return found


def _delay_checks(link: LinkPlan, flow: CalibrationFlow, came: FlowResult) -> list[Check]:
    delays = ExpectedDelays(link)
    lasts_s = flow.count * flow.every_s
    sending_ms = flow.frame_bytes * 8e3 / link.rate_bps if link.rate_bps else 0.0
    found = estimate.delay_figures(came.rows, sending_ms) if _enough(link, came) else None
    probes = max(estimate.FEWEST, len(came.rows))
    middle, jitter = delays.middle_ms(probes, lasts_s), delays.jitter_ms(probes, lasts_s)
    more = {} if found is None else {"median": found.median_ms, "mean": found.mean_ms}
    spread = {} if found is None else {"deviation": found.deviation_ms}
    measured = (None, None) if found is None else (found.middle_ms, delays.jitter_of(found.span_ms))
    return [
        Check(flow.link, "delay_ms", link.delay_us * _MS, measured[0], *_bounds(middle), *came.counts, more=more),
        Check(flow.link, "jitter_ms", link.jitter_us * _MS, measured[1], *_bounds(jitter), *came.counts, more=spread),
    ]


def _rate_check(link: LinkPlan, flow: CalibrationFlow, came: FlowResult) -> Check:
    share = arriving(link)
    if flow.overfills:
        measured = estimate.rate_when_overfilled(came.rows, flow.burst, flow.frame_bytes, share)
        paced_s = (flow.count - flow.burst) * flow.every_s
        interval = rate_bps(link, round(paced_s * (link.rate_bps or 0) / 8 / flow.frame_bytes), paced_s)
    else:
        measured = estimate.rate_when_received(came.rows, flow.frame_bytes)
        lasts_s = flow.count * flow.frame_bytes * 8 / (link.rate_bps or 1)
        interval = rate_bps(link, flow.count, lasts_s, _slope_error(link, lasts_s))
    return Check(flow.link, "rate_bps", link.rate_bps, measured, *_bounds(interval), *came.counts)


def _slope_error(link: LinkPlan, lasts_s: float) -> float:
    """The relative error that jitter causes in the slope of arrivals over `lasts_s`."""
    jitter_s = link.jitter_us / 1e6
    if not jitter_s:
        return 0.0
    values = max(2.0, VALUES_A_SLOT * lasts_s / (SLOT_JITTERS[link.distribution] * jitter_s))
    return jitter_s / lasts_s * math.sqrt(12 / values)


def _enough(link: LinkPlan, came: FlowResult) -> bool:
    """Whether at least half of the expected probes arrived."""
    return len(came.rows) >= came.sent * arriving(link) / 2


def _bounds(interval: Interval) -> tuple[float, float]:
    return interval.lowest, interval.highest


def _shown(figure: str, value: float) -> str:
    if figure == "rate_bps":
        return show_rate(round(float(f"{value:.3g}"))) if value >= 1 else "0bit"
    return f"{value:.3g} ms"
