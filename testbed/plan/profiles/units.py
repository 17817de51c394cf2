"""Conversion of figures with units from their text in a profile, and back."""

from __future__ import annotations

import re

_NUMBER = r"([0-9]{1,9}(?:\.[0-9]{1,9})?)"
_TIME_US = {"us": 1, "ms": 1_000, "s": 1_000_000}
_RATE_BPS = {"bit": 1, "kbit": 1_000, "Mbit": 1_000_000, "Gbit": 1_000_000_000}

LONGEST_US = 60_000_000
"""No link is slower than a minute: a delay above it is a slip of the unit."""
SLOWEST_BPS, FASTEST_BPS = 1_000, 100_000_000_000
LARGEST_QUEUE = 100_000
UNLIMITED = "unlimited"


def parse_time_us(text: str) -> int:
    """Parse `25ms`, `0.5 s`, `200us` into microseconds. Raises ValueError with what was expected."""
    found = re.fullmatch(rf"{_NUMBER} ?(us|ms|s)", text)
    if found is None:
        raise ValueError("a time with its unit (us, ms, s), as 25ms")
    return round(float(found[1]) * _TIME_US[found[2]])


def parse_delay_us(text: str) -> int:
    """Parse a time that a frame can spend on a link, at most a minute. Raises ValueError with what was expected."""
    time_us = parse_time_us(text)
    if time_us > LONGEST_US:
        raise ValueError(f"at most {LONGEST_US // 1_000_000}s")
    return time_us


def parse_rate_bps(text: str) -> int | None:
    """Parse `20Mbit`, `64 kbit` into bit/s; None for `unlimited`. Raises ValueError with what was expected."""
    if text == UNLIMITED:
        return None
    found = re.fullmatch(rf"{_NUMBER} ?(bit|kbit|Mbit|Gbit)", text)
    if found is None:
        raise ValueError("bits per second with their unit (bit, kbit, Mbit, Gbit), as 20Mbit, or unlimited")
    rate_bps = round(float(found[1]) * _RATE_BPS[found[2]])
    if not SLOWEST_BPS <= rate_bps <= FASTEST_BPS:
        raise ValueError("a rate from 1kbit to 100Gbit, or unlimited")
    return rate_bps


def parse_share(text: str) -> float:
    """Parse `1%`, `0.2 %` into a share, 0.01 and 0.002. Raises ValueError with what was expected."""
    found = re.fullmatch(rf"{_NUMBER} ?%", text)
    if found is None or float(found[1]) > 100:
        raise ValueError("a share from 0% to 100%, as 1%")
    return round(float(found[1]) / 100, 11)


def parse_packets(text: str) -> int:
    """Parse `100 packets` into a number. Raises ValueError with what was expected."""
    found = re.fullmatch(r"([0-9]{1,9}) ?packets?", text)
    if found is None:
        raise ValueError("a number of packets, as 100 packets")
    if not 1 <= int(found[1]) <= LARGEST_QUEUE:
        raise ValueError(f"from 1 packet to {LARGEST_QUEUE} packets")
    return int(found[1])


def show_time(time_us: int) -> str:
    """A time in its shortest form: `25ms`, `1.5s`, `200us`."""
    for unit in ("s", "ms"):
        if time_us and time_us >= _TIME_US[unit]:
            return f"{_decimal(time_us / _TIME_US[unit])}{unit}"
    return f"{time_us}us" if time_us else "0"


def show_rate(rate_bps: int | None) -> str:
    """`20Mbit`, `64kbit`, or `unlimited`."""
    if rate_bps is None:
        return UNLIMITED
    unit = next(unit for unit in ("Gbit", "Mbit", "kbit", "bit") if rate_bps >= _RATE_BPS[unit])
    return f"{_decimal(rate_bps / _RATE_BPS[unit])}{unit}"


def show_share(share: float) -> str:
    """`1%`, `0.2%`."""
    return f"{_decimal(share * 100)}%"


def _decimal(number: float) -> str:
    return f"{number:.9f}".rstrip("0").rstrip(".")
