"""Numbers and findings in words, the same on the terminal and on the page."""

from __future__ import annotations

from statistics import median
from typing import Any

_IN_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
PROTOCOL_NAMES = {"mqttxt": "MQTT-XT", "mavlink": "MAVLink"}
EXPERIMENT_NAMES = {"scenario-1": "Scenario 1"}
EXPERIMENT_WHAT = {"scenario-1": "arm, take off to 10 m, hold for 15 s, land, all disarmed"}


def size(count: float | None) -> str:
    """Bytes with three significant digits: 812 B, 40.2 kB, 1.53 MB."""
    if count is None:
        return "–"
    if count < 1000:
        return f"{count:.0f} B"
    value, unit = (count / 1e3, "kB") if count < 999_500 else (count / 1e6, "MB")
    decimals = 2 if value < 9.995 else 1 if value < 99.95 else 0
    return f"{value:,.{decimals}f} {unit}"


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
    return f"{percent(100 * share)} of {of:,}"


def percent(value: float) -> str:
    """Two significant digits below ten, whole ones above: 0.16 %, 4.5 %, 100 %."""
    return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"


def notes(metrics: dict[str, Any]) -> list[str]:
    """What one must know before believing the numbers: why attempts failed or are void, and what was cut off."""
    said = []
    for protocol, side in metrics["protocols"].items():
        name = PROTOCOL_NAMES.get(protocol, protocol)
        for attempt in side["attempts"]:
            which = f"{name}, attempt {attempt['attempt']}"
            if attempt["status"] != "completed":
                said.append(f"{which} {attempt['status']}: {attempt['reason']}")
            if attempt["truncated"]:
                files = ", ".join(attempt["truncated"])
                said.append(f"{which}: cut off, and counted up to the cut: {files}; its counts are too low")
        said += [f"{name}, attempt {void['attempt']} is void, not counted: {void['reason']}" for void in side["void"]]
    return said


def finding(metrics: dict[str, Any]) -> str:
    """One plain sentence: what was flown, over what, and how it went."""
    experiment = EXPERIMENT_NAMES.get(metrics["experiment"], metrics["experiment"]).lower()
    parts = []
    for protocol, side in metrics["protocols"].items():
        name = PROTOCOL_NAMES.get(protocol, protocol)
        flown, completed = side["attempts"], [a for a in side["attempts"] if a["status"] == "completed"]
        if not completed:
            which = "the only attempt was not" if len(flown) == 1 else f"none of {len(flown)} attempts was"
            parts.append(f"over {name} {which if flown else 'no attempt that counts was'} completed")
            continue
        mission = median(attempt["mission_s"] for attempt in completed)
        packets = median(attempt["packets"] for attempt in completed)
        bytes_ = median(attempt["size_bytes"] for attempt in completed)
        drones = _plural(len(completed[0]["outcomes"]), "drone")
        fogs = len({link.split(":")[1] for link in completed[0]["links"] if link.startswith("backhaul:")})
        on = _plural(_IN_WORDS[fogs] if fogs < len(_IN_WORDS) else fogs, "fog")
        much = "" if len(completed) == 1 else " (medians)"
        how = "" if len(completed) == len(flown) else f", in {len(completed)} of {len(flown)} attempts"
        parts.append(
            f"over {name} {drones} on {on} flew {experiment} in {mission:.1f} s, "
            f"with {packets:,.0f} packets and {size(bytes_)} on all links{much}{how}"
        )
    said = "; ".join(parts)
    return f"{said[0].upper()}{said[1:]}."


def _plural(count: int | str, what: str) -> str:
    return f"{count} {what}" if count in (1, "one") else f"{count} {what}s"
