"""Numbers in words, the same on the terminal and on the page."""

from __future__ import annotations

from .observed import in_order
from .written import Metrics, SideEntry

NOTHING = "–"


def sides(metrics: Metrics) -> list[tuple[str, SideEntry]]:
    """The protocols of a series with the measurements of each; always MQTT-XT first."""
    return [(name, metrics["protocols"][name]) for name in in_order(metrics["protocols"])]


def thousands(value: float | None) -> str:
    return NOTHING if value is None else f"{value:,.0f}"


def digits(value: float | None) -> str:
    """Three significant digits: 8,013, 445, 46.6, 1.25."""
    if value is None:
        return NOTHING
    if value == 0:
        return "0"
    return f"{value:,.{0 if value >= 99.95 else 1 if value >= 9.995 else 2}f}"


def size(count: float | None) -> str:
    """Bytes with three significant digits: 812 B, 40.2 kB, 1.53 MB."""
    if count is None:
        return NOTHING
    if count < 999.5:
        return f"{count:.0f} B"
    value, unit = (count / 1e3, "kB") if count < 999_500 else (count / 1e6, "MB")
    return f"{digits(value)} {unit}"


def seconds(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1f} s"


def milliseconds(value: float | None) -> str:
    if value is None:
        return NOTHING
    if value >= 999.5:
        return f"{value / 1000:.2f} s"
    return f"{value:.2f} ms" if value < 9.995 else f"{value:.0f} ms"


def delay(value: float) -> str:
    """A tick on a scale of delays, from milliseconds: 0.1 ms, 10 ms, 1 s."""
    return f"{value / 1000:g} s" if value >= 1000 else f"{value:g} ms"


def rate(value: float) -> str:
    """A tick on a scale of bytes per second: 100 B/s, 10 kB/s, 1 MB/s."""
    for unit, size_ in (("GB/s", 1e9), ("MB/s", 1e6), ("kB/s", 1e3)):
        if value >= size_:
            return f"{value / size_:g} {unit}"
    return f"{value:g} B/s"


def short(value: float) -> str:
    """A tick on a scale of counts: 100, 10 k, 1 M."""
    for unit, size_ in ((" M", 1e6), (" k", 1e3)):
        if value >= size_:
            return f"{value / size_:g}{unit}"
    return f"{value:g}"


def short_delay(value: float) -> str:
    """A link's delay, from milliseconds: 0.12 ms, 25 ms."""
    return f"{value:.{0 if value >= 9.95 else 1 if value >= 0.95 else 2}f} ms"


def bit_rate(value: float) -> str:
    """A link's rate, from bits per second: 64 kbit/s, 1.45 Mbit/s."""
    unit, size_ = ("Gbit/s", 1e9) if value >= 999.5e6 else ("Mbit/s", 1e6) if value >= 999.5e3 else ("kbit/s", 1e3)
    return f"{value / size_:.3g} {unit}"


def share(value: float | None) -> str:
    """A share as percent: 0.16 %, 5 %."""
    return NOTHING if value is None else percent(100 * value)


def tick_size(value: float) -> str:
    """A tick on a scale of bytes: 100 B, 10 kB, 1 MB."""
    return rate(value).removesuffix("/s")


def ratio(value: float | None) -> str:
    """A ratio with as many digits as are significant: 265, 12, 1.6, 1.02, 0.62."""
    if value is None:
        return NOTHING
    decimals = 0 if value >= 9.95 else 1 if value >= 1.095 else 2
    return f"{value:,.{decimals}f}" if value >= 0.095 or value == 0 else f"{value:.2g}"


def times(value: float, what: str) -> str:
    """A ratio in a sentence: '265 times the packets'; below one, '62 % of the packets'."""
    if value >= 0.995:
        return f"{ratio(value)} times {what}"
    return f"{min(100 * value, 99):.{0 if value >= 0.1 else 1}f} % of {what}"


def loss(share: float | None, of: int) -> str:
    """A loss as percent; where none of n was lost, with its 95 % bound, 3/n."""
    if share is None or of == 0:
        return NOTHING
    if share == 0:
        return f"0 of {of:,} (< {300 / of:.2g} %)" if of > 3 else f"0 of {of}"
    return f"{percent(100 * share)} of {of:,}"


def percent(value: float) -> str:
    """Two significant digits below ten, whole ones above: 0.16 %, 4.5 %, 100 %."""
    return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"
