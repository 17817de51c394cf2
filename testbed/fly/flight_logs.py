"""Compares an autopilot's own flight log (ULog) with the events that a witness recorded.

A witness's events have the host's time, a log has the autopilot's since its boot, which is no steady clock in a
simulation on a busy machine. The witness records this clock from each SYSTEM_TIME (event `clock`, five per second), and
a log's times are interpolated between these points. The uncertainty is measured: it is the largest difference of a
point from the interpolation between its two neighbours.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog
from pyulog.exceptions import ULogException

from ..errors import ResultsError
from .results import Attempt

TOLERANCE_MS = 250.0
"""By how much an event may differ from the log, in addition to the uncertainty of the times: EXTENDED_SYS_STATE is
sent every 50 ms, and a busy machine adds to that.
"""
TOLERANCE_M = 0.5
HOME_S = 0.5
"""How long after PX4 moved its home a height may still be relative to the previous one."""
LEAST_SPEED = 0.95
"""The least speed of the autopilot's clock against the host's. If slower, the drone's time was not the network's.

At 0.91 PX4s missed their own sensors, and went into failsafes.
"""
SILENT_S = 2.0
"""The longest gap of the simulated barometer, which is logged five times per second. With a longer one the simulation
stood still: a PX4 whose timer thread kept sleeping (`sitl.real.px4.BATCH`).
"""
ARMED = 2
"""vehicle_status.arming_state of an armed PX4."""
TOPICS = {
    "vehicle_status": "arming_state",
    "vehicle_land_detected": "landed",
    "vehicle_global_position": "alt",
    "home_position": "alt",
    "vehicle_air_data": "timestamp",
}
"""The topics that are read, and which field of each beside its timestamp."""

Values = NDArray[np.float64]


@dataclass(frozen=True)
class ComparedEvent:
    """One event: seconds since the drone's first arming, and how much later it is than in the log."""

    event: str
    at_s: float
    late_ms: float


@dataclass(frozen=True)
class Comparison:
    """The comparison of one drone's events with its log.

    `clock_ms` is the uncertainty of the log's times in the host's time, `speed` the speed of the autopilot's clock
    against the host's, `height_m` the largest difference of a reported height from the log's (None: none was
    reported). `off` says why the log does not confirm the flight; None if it does.
    """

    version: str
    changes: tuple[ComparedEvent, ...]
    clock_ms: float
    speed: float
    height_m: float | None
    off: str | None


def compare_flights(attempt: Attempt) -> dict[str, Comparison]:
    """Compare every drone that has a log; by node. Raises ResultsError for a log or events that cannot be compared."""
    events = attempt.autopilot_events()
    return {node: compare(path, events.get(node, [])) for node, path in _logs(attempt).items()}


def _logs(attempt: Attempt) -> dict[str, Path]:
    """The newest flight log of every PX4, by node. ArduPilot's logs (DataFlash) are kept but not compared."""
    folders = [path for path in sorted((attempt.path / "sitl").glob("*.log")) if not any(path.glob("*.BIN"))]
    return {folder.stem: _newest_log(folder) for folder in folders}


def _newest_log(folder: Path) -> Path:
    logs = sorted(folder.glob("*/*.ulg"))
    if not logs:
        raise ResultsError(f"{folder}: no flight log; expected <date>/<time>.ulg")
    return logs[-1]


def against(attempt: Attempt) -> str | None:
    """The first drone's `off`, with its node; None if all logs confirm their flights. Raises as `compare_flights`."""
    return next((f"{node}: {one.off}" for node, one in compare_flights(attempt).items() if one.off is not None), None)


def simulation_reason(attempt: Attempt) -> str | None:
    """Why a flight may have failed by its simulation: a slow clock, or sensors that stood still. Else None."""
    for node, events in attempt.autopilot_events().items():
        armed_ns = next((event["t_ns"] for event in events if event["event"] == "armed"), None)
        points = [e for e in events if e["event"] == "clock" and armed_ns is not None and e["t_ns"] >= armed_ns]
        took_ns = points[-1]["t_ns"] - points[0]["t_ns"] if points else 0
        if took_ns > 0 and (off := _too_slow((points[-1]["boot_ms"] - points[0]["boot_ms"]) * 1e6 / took_ns)):
            return f"{node}: {off}"
    for node, path in _logs(attempt).items():
        if off := _silent(_read(path), path):
            return f"{node}: {off}"
    return None


def compare(path: Path, events: Sequence[dict[str, Any]]) -> Comparison:
    """Compare one log with the events of its drone. Raises ResultsError if that is not possible."""
    log = _read(path)
    logged = _changes(log, path)
    if silent := _silent(log, path):
        return Comparison(_version(log), (), 0.0, 0.0, None, silent)
    told = [(event["event"], event["t_ns"]) for event in events if event["event"] in {name for name, _ in logged}]
    clock = [(event["boot_ms"], event["t_ns"]) for event in events if event["event"] == "clock"]
    if not logged or [name for name, _ in told] != [name for name, _ in logged]:
        said = " ".join(name for name, _ in told) or "nothing", " ".join(name for name, _ in logged) or "nothing"
        off = f"events and flight log disagree: the events have {said[0]}, the log {said[1]}"
        return Comparison(_version(log), (), 0.0, 0.0, None, off)
    boot_s, host_s = _clock(clock, told[0][1], path)
    by_log = np.interp([us / 1e6 for _, us in logged], boot_s, host_s)
    by_events = [(t_ns - told[0][1]) / 1e9 for _, t_ns in told]
    changes = tuple(
        ComparedEvent(name, round(at_s, 3), round(float(at_s - log_s) * 1e3, 1))
        for (name, _), at_s, log_s in zip(told, by_events, by_log, strict=True)
    )
    first, last = logged[0][1] / 1e6, logged[-1][1] / 1e6
    within = (boot_s >= first) & (boot_s <= last)
    clock_ms, speed = _steadiness(boot_s[within], host_s[within], path)
    height_m = _height_m(log, events, first, last)
    found = Comparison(_version(log), changes, round(clock_ms, 1), round(speed, 3), height_m, None)
    return replace(found, off=_off(found))


def _off(found: Comparison) -> str | None:
    limit_ms = TOLERANCE_MS + found.clock_ms
    for change in found.changes:
        if abs(change.late_ms) > limit_ms:
            return (
                f"events and flight log disagree: {change.event} {change.late_ms:.0f} ms after the log has it; "
                f"expected {limit_ms:.0f} ms at most"
            )
    if found.height_m is not None and found.height_m > TOLERANCE_M:
        return f"events and flight log disagree: heights by {found.height_m:.1f} m; expected {TOLERANCE_M:g} m at most"
    return _too_slow(found.speed)


def _too_slow(speed: float) -> str | None:
    if speed >= LEAST_SPEED:
        return None
    return (
        f"the autopilot's clock ran at {speed:.3f} of the time; expected {LEAST_SPEED:g} at least: "
        "the machine was too busy"
    )


def _silent(log: ULog, path: Path) -> str | None:
    """A line if the simulated barometer had too long a gap between first arming and last disarming; else None."""
    arming = [(name, us) for name, us in _changes(log, path) if name in ("armed", "disarmed")]
    if not arming:
        return None
    armed_us, (last, last_us) = arming[0][1], arming[-1]
    end_us = last_us if last == "disarmed" else int(_topic(log, "vehicle_status", path)["timestamp"][-1])
    told_us = [us for us in _topic(log, "vehicle_air_data", path)["timestamp"].tolist() if armed_us <= us <= end_us]
    silent_s = max(after - before for before, after in pairwise([armed_us, *told_us, end_us])) / 1e6
    if silent_s <= SILENT_S:
        return None
    return f"the autopilot's simulated sensors stood still for {silent_s:.1f} s; expected {SILENT_S:g} s at most"


def _read(path: Path) -> ULog:
    try:
        log = ULog(str(path), list(TOPICS), True)
    except (ULogException, OSError, TypeError, ValueError, IndexError, KeyError, struct.error) as error:
        raise ResultsError(f"{path}: no flight log that can be read: {error}") from error
    for one in log.data_list:
        if not {"timestamp", TOPICS[one.name]} <= set(one.data):
            raise ResultsError(f"{path}: {one.name}: expected timestamp and {TOPICS[one.name]}, as PX4 logs them")
    return log


def _version(log: ULog) -> str:
    return f"{log.msg_info_dict.get('ver_sw_branch', '')} {str(log.msg_info_dict.get('ver_sw', ''))[:10]}".strip()


def _topic(log: ULog, name: str, path: Path) -> dict[str, Any]:
    found = next((one.data for one in log.data_list if one.name == name), None)
    if found is None:
        raise ResultsError(f"{path}: no {name} in it; expected the topics of PX4's default set")
    return dict(found)


def _changes(log: ULog, path: Path) -> list[tuple[str, int]]:
    """Armings, takeoffs, landings and disarmings since the first arming, with the autopilot's time in us."""
    status, land = _topic(log, "vehicle_status", path), _topic(log, "vehicle_land_detected", path)
    found = _turns(status["timestamp"], status["arming_state"] == ARMED, "armed", "disarmed")
    found += _turns(land["timestamp"], land["landed"] == 0, "took_off", "landed")
    found.sort(key=lambda one: one[1])
    first = next((i for i, (name, _) in enumerate(found) if name == "armed"), len(found))
    return found[first:]


def _turns(times_us: Any, states: Any, on: str, off: str) -> list[tuple[str, int]]:
    rows = zip(times_us.tolist(), states.tolist(), strict=True)
    return [(on if state else off, int(us)) for (_, before), (us, state) in pairwise(rows) if state != before]


def _clock(points: Sequence[tuple[int, int]], zero_ns: int, path: Path) -> tuple[Values, Values]:
    """Of each point the autopilot's seconds since its boot, and the host's since `zero_ns`."""
    if len(points) < 3:
        raise ResultsError(f"{path}: only {len(points)} clock events beside it; expected five a second")
    boot, host = zip(*points, strict=True)
    return np.array(boot) / 1e3, (np.array(host) - zero_ns) / 1e9


def _steadiness(boot_s: Values, host_s: Values, path: Path) -> tuple[float, float]:
    """The largest difference of a point from its neighbours' interpolation, in ms, and the clock's speed."""
    if len(boot_s) < 3:
        raise ResultsError(f"{path}: no clock events in the flight; expected five a second")
    share = (boot_s[1:-1] - boot_s[:-2]) / np.maximum(boot_s[2:] - boot_s[:-2], 1e-9)
    between = host_s[:-2] + share * (host_s[2:] - host_s[:-2])
    return float(np.abs(host_s[1:-1] - between).max() * 1e3), float(np.ptp(boot_s) / np.ptp(host_s))


def _height_m(log: ULog, events: Sequence[dict[str, Any]], first_s: float, last_s: float) -> float | None:
    """The largest difference of reported heights above home from the log's, at the autopilot's own times; None if none
    was reported. After PX4 has moved its home, reported heights are for a moment relative to the previous one.
    """
    topics = {one.name: one.data for one in log.data_list}
    if not {"vehicle_global_position", "home_position"} <= set(topics):
        return None
    place, home = topics["vehicle_global_position"], topics["home_position"]
    homes_s, homes_m = home["timestamp"] / 1e6, home["alt"]
    off = []
    for event in events:
        at_s = event.get("boot_ms", 0) / 1e3
        if event["event"] != "position" or not first_s <= at_s <= last_s:
            continue
        up_m = float(np.interp(at_s, place["timestamp"] / 1e6, place["alt"]))
        since, until = np.searchsorted(homes_s, [at_s - HOME_S, at_s + HOME_S])
        valid = homes_m[max(int(since) - 1, 0) : max(int(until), 1)]
        off.append(float(np.abs(event["altitude_m"] - (up_m - valid)).min()))
    return round(max(off), 2) if off else None
