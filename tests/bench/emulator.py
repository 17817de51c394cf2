"""The link emulator's packet rates on one core, and how exactly it keeps times; needs Docker and the node image."""

from __future__ import annotations

from typing import Any

from tests.rigs.shaped_link import ShapedLink

SIZE_BYTES = 200
DELAY_US = 20_000
QUIET_HZ, BUSY_HZ, FULL_HZ = 200, 10_000, 30_000
SECONDS = 4


def measure() -> list[str]:
    """Three lines; takes about 25 s."""
    with ShapedLink() as link:
        return [_at(link, rate_hz) for rate_hz in (QUIET_HZ, BUSY_HZ, FULL_HZ)]


def _at(link: ShapedLink, rate_hz: int) -> str:
    planned: dict[str, Any] = {"delay_us": DELAY_US, "jitter_us": 5000, "loss": 0.001}
    count = rate_hz * SECONDS
    with link.shaping(planned) as emulator:
        before_s = emulator.cpu_s()
        rows = emulator.flow(count, rate_hz, SIZE_BYTES)
        used_s = emulator.cpu_s() - before_s
        content = emulator.end()
    counted = content["links"]["wan:gs:up"]
    sent_s = (max(row.sent_ns for row in rows) - min(row.sent_ns for row in rows)) / 1e9
    late = content["late_ms"]
    return (
        f"emulator: at {count / sent_s:,.0f} packets/s {100 * used_s / sent_s:.0f} % of one core, "
        f"{used_s / count * 1e6:.1f} us a packet ({count / used_s:,.0f} on a whole core); "
        f"late by {late['p50']:.2f} ms p50, {late['p99']:.2f} ms p99, {late['max']:.1f} ms at most; "
        f"lost to overload: {counted['overload']}"
    )
