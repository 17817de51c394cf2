"""Fits the rates of the `thesis` profile to PX4's streams, and tries them on the real shaper: `tests.bench fit`.

Both stream sets are recorded from six stand-ins in flight (FIT_RECORDINGS names a folder of earlier recordings to use
instead), fitted by simulation, and replayed through real links by the shaper, one drone and six. Not among the figures
of `make bench`: it takes about ten minutes or more, and needs Docker and the node image for the last part.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from docker.errors import DockerException

from testbed.plan.fleets import standard_fleet
from testbed.plan.profiles.reading import read_profile
from testbed.plan.profiles.resolve import LinksPlan, resolve
from tests.bench import fit_replay
from tests.bench.fit_network import ShapedNetwork
from tests.bench.fit_search import Fit, Point, Trial, fit, wan_for
from tests.bench.fit_simulation import DOWN
from tests.bench.fit_streams import ROOT, Streams, read, record, write

SETS = ("px4-onboard", "px4-gcs")
DRONES, SECONDS = 6, 60.0
FOLDER = ROOT / ".cache" / "fit"
STATES = {
    "battery": "BATTERY_STATUS",
    "groundspeed": "VFR_HUD",
    "location and heading": "GLOBAL_POSITION_INT",
    "flight mode": "HEARTBEAT",
}
SCAN_BPS = 5_000
REPLAYS = 3
Rates = tuple[int, int]
"""Rates up each air link, and down the wan, in bit/s."""


def measure() -> Iterator[str]:
    """Lines for both sets: the load, the fit, each state's own loss, and the shaper's counts."""
    topology = standard_fleet().topology()
    plan = resolve(read_profile("thesis"), topology, "scenario-1", 1)
    rates: dict[str, list[Rates]] = {}
    recorded = {}
    for chosen in SETS:
        streams = recorded[chosen] = _streams(chosen)
        trial = Trial(streams, plan.links, plan.seed)
        frames_s = sum(map(len, streams.values())) / len(streams) / SECONDS
        yield f"{chosen}: each drone sends {frames_s:.0f} frames/s, {trial.load_bps / 1000:.0f} kbit/s"
        found = fit(trial)
        as_it_is = trial.at(*_rates(plan))
        yield from (f"{chosen}: {line}" for line in _fitted(trial, found))
        alone = trial.at(as_it_is.air_bps)
        yield f"{chosen}: the profile as it is, one UAV with air {alone.air_bps / 1000:.0f} kbit/s: {_lost(alone)}"
        yield f"{chosen}: the profile as it is, six with wan {_six(as_it_is)}"
        yield from (f"{chosen}: {line}" for line in _by_state(trial, found))
        rates[chosen] = [_rates(plan), (found.six.air_bps, found.six.wan_bps or 0)]
    try:
        with ShapedNetwork(topology) as made:
            for chosen, streams in recorded.items():
                pair = rates[chosen][0 if chosen == SETS[0] else 1]
                for drones in ((1,), tuple(streams)):
                    some = {drone: streams[drone] for drone in drones}
                    yield from (f"{chosen}: {line}" for line in _replayed(made, some, plan, pair))
    except DockerException as error:
        yield f"not replayed, Docker does not answer: {error}"


def _streams(chosen: str) -> Streams:
    earlier = os.environ.get("FIT_RECORDINGS")
    if earlier:
        return read(Path(earlier) / f"{chosen}.json")
    streams = record(chosen, DRONES, SECONDS)
    write(FOLDER / f"{chosen}.json", streams)
    return streams


def _fitted(trial: Trial, found: Fit) -> Iterator[str]:
    one, six, wire = found.one, found.six, found.wire
    yield (
        f"one UAV loses 8-15 % of its frames with air {_range(found.air)}; fitted {one.air_bps / 1000:.0f} kbit/s: "
        f"{_lost(one)}"
    )
    yield f"six lose 20-28 % end to end with wan {_range(found.wan)}; fitted {_six(six)}"
    yield f"six lose 20-28 % over all links with wan {_range(found.wan_wire)}; in the middle {_six(wire)}"
    for air_bps in found.air:
        end_to_end, _ = wan_for(trial, air_bps, lambda point: point.losses.end_to_end)
        over_all, _ = wan_for(trial, air_bps, lambda point: point.losses.wire)
        wan = f"wan {_range(end_to_end)} end to end, {_range(over_all)} over all links"
        yield f"with air {air_bps / 1000:.0f} kbit/s: {wan}"


def _by_state(trial: Trial, found: Fit) -> Iterator[str]:
    """The losses of the five states, which leave the autopilot at fixed places in its bursts."""
    for point in (found.one, found.six):
        shares = ", ".join(f"{state} {_percent(point.losses.kinds[kind])}" for state, kind in STATES.items())
        yield f"{'one UAV' if point is found.one else 'six UAVs'} at the fitted rates: {shares}"
    rates = range(trial.load_bps // 2 // SCAN_BPS * SCAN_BPS, trial.load_bps + SCAN_BPS, SCAN_BPS)
    for state, kind in STATES.items():
        kept = [rate for rate in rates if 0.08 <= trial.at(rate).losses.kinds[kind] <= 0.15]
        listed = ", ".join(f"{rate / 1000:.0f}" for rate in kept) or "none"
        yield f"one UAV loses 8-15 % of {state} with air (kbit/s): {listed}"


def _replayed(made: ShapedNetwork, streams: Streams, plan: LinksPlan, rates: Rates) -> Iterator[str]:
    """Replay with real packets at these rates; again if a busy machine made it void."""
    for _ in range(REPLAYS):
        found = fit_replay.replay(made, streams, plan, *rates)
        if found.void is None:
            break
    measured, expected, planned = (
        f"{_percent(end_to_end)} end to end and {_percent(over_all)} over all links"
        for end_to_end, over_all in (found.counted, found.worked_out, found.planned)
    )
    yield (
        f"{len(streams)} replayed, air {rates[0] / 1000:.0f} and wan {rates[1] / 1000:.0f} kbit/s: "
        f"lost by the shaper's counters {measured}; simulated {expected}, "
        f"with the recording's times {planned}; sent {found.late_ms} ms late at most; void: {found.void}"
    )
    for state, kind in STATES.items():
        yield (
            f"{len(streams)} replayed: of {state} lost {_percent(found.measured.kinds[kind])}, "
            f"simulated {_percent(found.expected.kinds[kind])}"
        )


def _rates(plan: LinksPlan) -> Rates:
    """The profile's present rates."""
    air_bps, wan_bps = plan.links["air:uav1:up"].rate_bps, plan.links[DOWN].rate_bps
    assert air_bps is not None
    assert wan_bps is not None
    return air_bps, wan_bps


def _lost(point: Point) -> str:
    drones = point.losses.drones.values()
    spread = f"{_percent(min(drones))} to {_percent(max(drones))} of a drone's frames"
    return f"{_percent(point.losses.end_to_end)} ({spread}), {_calls(point)}"


def _six(point: Point) -> str:
    assert point.wan_bps is not None
    return (
        f"{point.wan_bps / 1000:.0f} kbit/s: {_percent(point.losses.end_to_end)} end to end, "
        f"{_percent(point.losses.wire)} over all links, {_calls(point)}"
    )


def _calls(point: Point) -> str:
    return f"{_percent(point.losses.kinds['COMMAND_ACK'])} of answers, {_percent(point.calls)} of calls unanswered"


def _range(rates: tuple[int, int]) -> str:
    return f"{rates[0] / 1000:.0f} to {rates[1] / 1000:.0f} kbit/s"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
