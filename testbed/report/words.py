"""Numbers and findings in words, the same on the terminal and on the page."""

from __future__ import annotations

from statistics import median
from typing import Any

PROTOCOL_NAMES = {"mqttxt": "MQTT-XT", "mavlink": "MAVLink"}
EXPERIMENT_NAMES = {"scenario-1": "Scenario 1"}
EXPERIMENT_WHAT = {"scenario-1": "arm, take off to 10 m, hold for 15 s, land, all disarmed"}


def size(count: float | None) -> str:
    """Bytes with three significant digits: 812 B, 40.2 kB, 1.53 MB."""
    if count is None:
        return "–"
    for unit, factor in (("MB", 1e6), ("kB", 1e3)):
        if count >= factor:
            return f"{count / factor:.3g} {unit}"
    return f"{count:.0f} B"


def seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} s"


def milliseconds(value: float | None) -> str:
    if value is None:
        return "–"
    if value >= 1000:
        return f"{value / 1000:.2f} s"
    return f"{value:.2f} ms" if value < 10 else f"{value:.0f} ms"


def short_loss(share: float | None, of: int) -> str:
    """A loss where there is little room: how many of how many."""
    return "–" if share is None or of == 0 else f"{round(share * of):,} of {of:,}"


def loss(share: float | None, of: int) -> str:
    """A loss as percent; none of n is shown with its 95 % bound, below 3/n."""
    if share is None or of == 0:
        return "–"
    if share == 0:
        return f"0 of {of:,} (< {300 / of:.2g} %)" if of > 3 else f"0 of {of}"
    return f"{100 * share:.2g} % of {of:,}"


def finding(metrics: dict[str, Any]) -> str:
    """One plain sentence: what was flown, over what, and how it went."""
    experiment = EXPERIMENT_NAMES.get(metrics["experiment"], metrics["experiment"]).lower()
    parts = []
    for protocol, side in metrics["protocols"].items():
        name = PROTOCOL_NAMES.get(protocol, protocol)
        flown, completed = side["attempts"], [a for a in side["attempts"] if a["status"] == "completed"]
        if not completed:
            parts.append(f"over {name} none of {len(flown)} attempts was completed")
            continue
        mission = median(attempt["mission_s"] for attempt in completed)
        packets = median(attempt["packets"] for attempt in completed)
        bytes_ = median(attempt["size_bytes"] for attempt in completed)
        drones = len(completed[0]["outcomes"])
        much = "" if len(completed) == 1 else " (medians)"
        how = "" if len(completed) == len(flown) else f", in {len(completed)} of {len(flown)} attempts"
        parts.append(
            f"over {name} {drones} drones on two fogs flew {experiment} in {mission:.1f} s, "
            f"with {packets:,.0f} packets and {size(bytes_)} on all links{much}{how}"
        )
    said = "; ".join(parts)
    return f"{said[0].upper()}{said[1:]}."
