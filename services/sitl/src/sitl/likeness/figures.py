"""Statistics of an autopilot's messages: rates and sizes, and how values wander."""

from __future__ import annotations

import itertools
import math
import statistics
from collections import Counter
from collections.abc import Sequence
from typing import Any

from .channel import Heard


def of(heard: Sequence[Heard]) -> dict[str, float]:
    """Standard deviations about a straight line, and how often rarely sent values change."""
    positions = _of_kind(heard, "GLOBAL_POSITION_INT")
    local = _of_kind(heard, "LOCAL_POSITION_NED")
    found = {
        "heading_deg": _about_line([one.hdg / 100 for one in positions], circle=360),
        "altitude_m": _about_line([one.alt / 1000 for one in positions]),
        "relative_altitude_m": _about_line([one.relative_alt / 1000 for one in positions]),
        "north_m": _about_line([one.x for one in local]),
        "east_m": _about_line([one.y for one in local]),
        "climb_m_s": _about_line([one.vz for one in local]),
        "speed_m_s": _about_line([math.hypot(one.vx, one.vy) for one in local]),
        "roll_deg": _about_line([math.degrees(one.roll) for one in _of_kind(heard, "ATTITUDE")]),
        "voltage_v": _about_line([one.voltage_battery / 1000 for one in _of_kind(heard, "SYS_STATUS")]),
        "current_a": statistics.fmean([one.current_battery / 100 for one in _of_kind(heard, "SYS_STATUS")]),
    }
    batteries = _of_kind(heard, "SYS_STATUS")
    found["battery_pct at first"] = batteries[0].battery_remaining
    found["battery_pct at last"] = batteries[-1].battery_remaining
    return {name: round(value, 4) for name, value in {**found, **changes(heard)}.items()}


def streams(heard: Sequence[Heard]) -> dict[str, tuple[float, float]]:
    """Rates and mean sizes by kind, in the autopilot's own seconds; answers are left out."""
    clock = [one.message.time_boot_ms for one in heard if one.message.get_type() == "ATTITUDE"]
    seconds = (clock[-1] - clock[0]) / 1000 * len(clock) / (len(clock) - 1)
    counts: Counter[str] = Counter()
    sizes: Counter[str] = Counter()
    for one in heard:
        if one.kind not in ("COMMAND_ACK", "STATUSTEXT", "PARAM_VALUE"):
            counts[one.kind] += 1
            sizes[one.kind] += one.size_bytes
    return {kind: (round(count / seconds, 2), round(sizes[kind] / count, 1)) for kind, count in sorted(counts.items())}


def changes(heard: Sequence[Heard]) -> dict[str, float]:
    """How often home, heading (whole degrees) and battery (percent) changed from one message to the next."""
    homes = [(one.latitude, one.longitude, one.altitude) for one in _of_kind(heard, "HOME_POSITION")]
    headings = [round(one.hdg / 100) % 360 for one in _of_kind(heard, "GLOBAL_POSITION_INT")]
    percents = [one.battery_remaining for one in _of_kind(heard, "BATTERY_STATUS")]
    jumps = [math.dist(_metres(a), _metres(b)) for a, b in itertools.pairwise(homes) if a != b]
    return {
        "changes of home": _changed(homes),
        "changes of heading": _changed(headings),
        "changes of battery": _changed(percents),
        "largest jump of home_m": round(max(jumps, default=0.0), 3),
        "height of home from first to last_m": round((homes[-1][2] - homes[0][2]) / 1000, 2) if homes else 0.0,
    }


def _metres(home: tuple[int, int, int]) -> tuple[float, float, float]:
    scale = 6_371_000 * math.radians(1e-7)
    return home[0] * scale, home[1] * scale * math.cos(math.radians(home[0] / 1e7)), home[2] / 1000


def _changed(values: Sequence[Any]) -> int:
    return sum(a != b for a, b in itertools.pairwise(values))


def _of_kind(heard: Sequence[Heard], kind: str) -> list[Any]:
    return [one.message for one in heard if one.kind == kind]


def _about_line(values: Sequence[float], circle: float | None = None) -> float:
    """The standard deviation about the regression line; on a circle, of the distance around from the first value."""
    if circle is not None:
        values = [(value - values[0] + circle / 2) % circle for value in values]
    if len(values) < 3:
        return 0.0
    line = statistics.linear_regression(range(len(values)), values)
    return statistics.pstdev(value - line.intercept - line.slope * i for i, value in enumerate(values))
