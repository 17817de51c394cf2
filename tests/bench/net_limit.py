"""The packet rate that `net` carries as a whole, beside what a flight needs; needs Docker and the node image.

`net` routes, captures on both sides and emulates, as in a flight. Every packet enters one link; a flight's packets are
counted per link, so that one over three links is three.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.rigs.shaped_link import ShapedLink, plan_of

FINDINGS = Path(__file__).parents[2] / "docs" / "findings" / "scenario-1"
RATES_HZ = (1_000, 2_000, 3_000, 4_000, 6_000, 8_000, 12_000, 16_000, 24_000, 32_000)
SIZE_BYTES, SECONDS, DELAY_US = 100, 4, 20_000
SENT = 0.95
"""The share of a rate that the sender has to reach; otherwise the limit found is the sender's."""


def measure() -> list[str]:
    """One line; takes a minute or two."""
    needed = {protocol: most_needed(FINDINGS, protocol) for protocol in ("mqttxt", "mavlink")}
    with ShapedLink() as link:
        carried_hz, why = _limit_hz(link)
    drones = ", ".join(
        f"{carried_hz / each_hz:,.0f} drones over {protocol} ({each_hz:,.0f} each, {arm})"
        for protocol, (each_hz, arm) in needed.items()
    )
    return [f"net's limit: {carried_hz:,.0f} packets/s with none lost, late or uncaptured ({why}): {drones}"]


def most_needed(findings: Path, protocol: str) -> tuple[float, str]:
    """Packets per second and drone, on all links together, of the busiest series of a folder, and that one's name."""
    found: list[tuple[float, str]] = []
    for path in sorted(findings.glob("*/*/metrics.json")):
        side = json.loads(path.read_text())["protocols"].get(protocol, {"attempts": []})
        for attempt in side["attempts"]:
            if attempt["mission_s"]:
                each_hz = attempt["packets"] / attempt["mission_s"] / len(attempt["outcomes"])
                found.append((each_hz, path.parent.parent.name))
    return max(found)


def _limit_hz(link: ShapedLink) -> tuple[float, str]:
    """The highest rate that was carried, and what ended the search."""
    best_hz = 0.0
    for rate_hz in RATES_HZ:
        sent_hz, against = _carry(link, rate_hz)
        if against is not None:
            return best_hz, f"at {sent_hz:,.0f}: {against}"
        best_hz = sent_hz
    return best_hz, "nothing more was tried"


def _carry(link: ShapedLink, rate_hz: int) -> tuple[float, str | None]:
    """The rate at which packets were sent, and what went wrong, or None."""
    count = rate_hz * SECONDS
    with link.routing(plan_of(planned := {"delay_us": DELAY_US}, (), planned), always=True, shaper="nfqueue") as net:
        rows = net.flow(count, rate_hz, SIZE_BYTES)
        counters = net.end()
        captures = json.loads(net.read("pcap/captures.json"))
    sent_s = max(row.sent_ns for row in rows) - min(row.sent_ns for row in rows)
    sent_hz = count / (sent_s / 1e9)
    return sent_hz, _against(count, len(rows), counters, captures) or (
        None if sent_hz >= SENT * rate_hz else "the sender is not faster"
    )


def _against(count: int, arrived: int, counters: Mapping[str, Any], captures: list[dict[str, Any]]) -> str | None:
    if counters["void"] is not None:
        return str(counters["void"])
    if arrived < count:
        return f"{count - arrived} of {count} packets lost"
    dropped = sum(capture["dropped"] or 0 for capture in captures)
    return f"captures dropped {dropped}" if dropped else None
