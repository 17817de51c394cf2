"""Flight in metres and seconds: acceleration-limited motion, and a battery that it drains."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

EARTH_M = 6_371_000.0
VERTICAL_ACCELERATION_M_S2 = 2.0
Vector = tuple[float, float, float]
"""North, east, up."""
HOVER_W = 220.0
CLIMB_W_PER_M_S = 60.0
CRUISE_W_PER_M_S = 8.0
IDLE_W = 8.0


@dataclass(frozen=True)
class Place:
    """WGS84 degrees and metres above mean sea level."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    def offset(self, north_m: float, east_m: float, up_m: float) -> Place:
        """The place that lies so many metres away."""
        latitude = self.latitude_deg + math.degrees(north_m / EARTH_M)
        radius = EARTH_M * math.cos(math.radians(self.latitude_deg))
        return Place(latitude, self.longitude_deg + math.degrees(east_m / radius), self.altitude_m + up_m)

    def metres_to(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """North and east to a position."""
        north = math.radians(latitude_deg - self.latitude_deg) * EARTH_M
        east = math.radians(longitude_deg - self.longitude_deg) * EARTH_M * math.cos(math.radians(self.latitude_deg))
        return north, east


@dataclass
class Motion:
    """Where a drone is relative to its home and how fast: north, east, up in metres and metres a second."""

    position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    yaw_rad: float = 0.0

    @property
    def groundspeed_m_s(self) -> float:
        return math.hypot(self.velocity[0], self.velocity[1])

    def step(self, wanted: Vector, acceleration_m_s2: float, dt_s: float) -> None:
        """Move on by `dt_s` towards the wanted velocity, as fast as the acceleration allows; the ground stops."""
        change = [wanted[0] - self.velocity[0], wanted[1] - self.velocity[1]]
        size = math.hypot(*change)
        most = acceleration_m_s2 * dt_s
        scale = 1.0 if size <= most else most / size
        self.velocity[0] += change[0] * scale
        self.velocity[1] += change[1] * scale
        most = VERTICAL_ACCELERATION_M_S2 * dt_s
        self.velocity[2] += max(-most, min(most, wanted[2] - self.velocity[2]))
        for axis in range(3):
            self.position[axis] += self.velocity[axis] * dt_s
        if self.position[2] <= 0.0 and self.velocity[2] <= 0.0:
            self.position[2] = 0.0
            self.velocity = [0.0, 0.0, 0.0]
        if self.groundspeed_m_s > 0.5:
            self.yaw_rad = math.atan2(self.velocity[1], self.velocity[0])


def approach(distance_m: float, fastest_m_s: float, braking_m_s2: float) -> float:
    """The speed towards something `distance_m` away (signed) from which one can still stop there."""
    speed = min(fastest_m_s, math.sqrt(2 * 0.8 * braking_m_s2 * abs(distance_m)), abs(distance_m) * 2)
    return math.copysign(speed, distance_m)


@dataclass
class Battery:
    """Energy in watt hours; a multicopter drains most by staying up, more by climbing and moving."""

    capacity_wh: float
    left_wh: float
    power_w: float = IDLE_W

    @property
    def remaining_pct(self) -> float:
        return max(0.0, 100.0 * self.left_wh / self.capacity_wh)

    @property
    def voltage_v(self) -> float:
        return 14.0 + 2.8 * self.remaining_pct / 100

    def step(self, motion: Motion, flying: bool, dt_s: float) -> None:
        self.power_w = IDLE_W
        if flying:
            climbing = max(0.0, motion.velocity[2])
            self.power_w = HOVER_W + CLIMB_W_PER_M_S * climbing + CRUISE_W_PER_M_S * motion.groundspeed_m_s
        self.left_wh = max(0.0, self.left_wh - self.power_w * dt_s / 3600)
