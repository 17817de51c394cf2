"""Flight logs (ULog, version 1) with a few topics in them, as PX4 writes them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

HEAD = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
TOPICS = {
    "vehicle_status": ("uint8_t arming_state", "<QB"),
    "vehicle_land_detected": ("bool landed", "<Q?"),
    "vehicle_global_position": ("float alt", "<Qf"),
    "home_position": ("float alt", "<Qf"),
    "vehicle_air_data": ("float baro_alt_meter", "<Qf"),
}


@dataclass
class Flight:
    """A flight by the autopilot's own clock, in seconds since its boot; the log ends `logged_s` after it."""

    armed_s: float = 10.0
    took_off_s: float = 12.0
    landed_s: float = 40.0
    disarmed_s: float = 42.0
    height_m: float = 10.0
    home_amsl_m: float = 488.0
    silent_s: tuple[float, float] = (0.0, 0.0)
    logged_s: float = 2.0
    topics: Sequence[str] = field(default_factory=lambda: list(TOPICS))

    def height_at(self, at_s: float) -> float:
        """The height above home: it climbs for two seconds, and descends for two."""
        climbed, left = at_s - self.took_off_s, self.landed_s - at_s
        return self.height_m * max(0.0, min(1.0, climbed / 2, left / 2))

    def rows(self) -> list[tuple[float, str, float]]:
        """Time, topic, value."""
        found: list[tuple[float, str, float]] = [(1.0, "home_position", self.home_amsl_m)]
        at_s = 1.0
        while at_s < self.disarmed_s + self.logged_s:
            armed = self.armed_s <= at_s < self.disarmed_s
            flying = self.took_off_s <= at_s < self.landed_s
            found.append((at_s, "vehicle_status", 2 if armed else 1))
            found.append((at_s, "vehicle_land_detected", not flying))
            found.append((at_s, "vehicle_global_position", self.home_amsl_m + self.height_at(at_s)))
            if not self.silent_s[0] < at_s < self.silent_s[1]:
                found.append((at_s, "vehicle_air_data", self.home_amsl_m + self.height_at(at_s)))
            at_s = round(at_s + 0.01, 2)
        return found


def write_ulog(path: Path, flight: Flight) -> Path:
    """Write the log of a flight."""
    path.parent.mkdir(parents=True, exist_ok=True)
    parts = [HEAD, _info("ver_sw", "02e73e3b6f4826a376d0"), _info("ver_sw_branch", "main")]
    for name in flight.topics:
        parts.append(_message(b"F", f"{name}:uint64_t timestamp;{TOPICS[name][0]};".encode()))
    for number, name in enumerate(flight.topics):
        parts.append(_message(b"A", struct.pack("<BH", 0, number) + name.encode()))
    for at_s, name, value in flight.rows():
        if name in flight.topics:
            data = struct.pack(TOPICS[name][1], round(at_s * 1e6), value)
            parts.append(_message(b"D", struct.pack("<H", list(flight.topics).index(name)) + data))
    path.write_bytes(b"".join(parts))
    return path


def _message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


def _info(key: str, value: str) -> bytes:
    name = f"char[{len(value)}] {key}".encode()
    return _message(b"I", bytes([len(name)]) + name + value.encode())
