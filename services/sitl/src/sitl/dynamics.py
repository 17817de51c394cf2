"""Flight in metres and seconds: acceleration-limited motion, and a battery that it drains."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

EARTH_M = 6_371_000.0
GRAVITY_M_S2 = 9.80665
LAG_S = 0.4
"""How far the drone lags behind its trajectory."""
SPEEDING_UP = 0.7
"""The share of its acceleration with which a trajectory speeds up if it waits for its drone."""
TURNING_M_S = 0.5
"""Below this speed the drone does not turn into its direction of flight."""
YAW_RATE_RAD_S = math.radians(60)
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
        """The place at this distance north, east and up from here."""
        latitude = self.latitude_deg + math.degrees(north_m / EARTH_M)
        radius = EARTH_M * math.cos(math.radians(self.latitude_deg))
        return Place(latitude, self.longitude_deg + math.degrees(east_m / radius), self.altitude_m + up_m)

    def metres_to(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """The distance north and east from here to a position."""
        north = math.radians(latitude_deg - self.latitude_deg) * EARTH_M
        east = math.radians(longitude_deg - self.longitude_deg) * EARTH_M * math.cos(math.radians(self.latitude_deg))
        return north, east


@dataclass
class Limits:
    """A trajectory's limits, in metres and seconds: horizontal, upward and downward acceleration, and jerk.

    A trajectory that `waits` for its drone speeds up with a part of its acceleration, and with less while the drone
    turns. `turning_rad_s2` is the angular acceleration of that turn.
    """

    horizontal: float
    up: float
    down: float
    jerk: float
    waits: bool = True
    turning_rad_s2: float = math.radians(20)


@dataclass
class Motion:
    """A drone's position relative to its origin, and its velocity: north, east, up in metres and metres per second.

    `aim` is the velocity of the trajectory, which changes within limits of acceleration and jerk; the drone's own
    velocity follows it, LAG_S behind.
    """

    position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    yaw_rad: float = 0.0
    yaw_aim_rad: float = 0.0
    aim: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    acceleration: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    _yaw_rate: float = 0.0

    @property
    def groundspeed_m_s(self) -> float:
        return math.hypot(self.velocity[0], self.velocity[1])

    def step(self, wanted: Vector, limits: Limits, dt_s: float) -> None:
        """Move for `dt_s` towards the velocity `wanted`; the ground stops the drone."""
        self._aim_across(wanted, limits, dt_s)
        self._aim_up(wanted[2], limits, dt_s)
        share = dt_s / LAG_S
        for axis in range(3):
            self.velocity[axis] += (self.aim[axis] - self.velocity[axis]) * share
            self.position[axis] += self.velocity[axis] * dt_s
        if self.position[2] <= 0.0 and self.velocity[2] <= 0.0:
            self.rest(0.0)
        if math.hypot(wanted[0], wanted[1]) > TURNING_M_S:
            self.yaw_aim_rad = math.atan2(wanted[1], wanted[0])
        self._turn(limits.turning_rad_s2, dt_s)

    def fall(self, speed_m_s: float, dt_s: float) -> None:
        """Fall without motors for `dt_s`, down to the ground; `speed_m_s` (negative) is the terminal speed."""
        for axis in (0, 1):
            self.aim[axis] = self.velocity[axis]
            self.position[axis] += self.velocity[axis] * dt_s
        self.velocity[2] = max(speed_m_s, self.velocity[2] - GRAVITY_M_S2 * dt_s)
        self.position[2] += self.velocity[2] * dt_s
        if self.position[2] <= 0.0:
            self.rest(0.0)

    def rest(self, up_m: float) -> None:
        """Come to rest at a height."""
        self.position[2] = up_m
        for values in (self.velocity, self.aim, self.acceleration):
            values[:] = (0.0, 0.0, 0.0)

    def _aim_across(self, wanted: Vector, limits: Limits, dt_s: float) -> None:
        north, east = wanted[0] - self.aim[0], wanted[1] - self.aim[1]
        change = math.hypot(north, east)
        if change < 1e-9 and self.acceleration[0] == self.acceleration[1] == 0.0:
            return
        waits = limits.waits and math.hypot(wanted[0], wanted[1]) > math.hypot(self.aim[0], self.aim[1])
        most = limits.horizontal * (SPEEDING_UP * self._facing() if waits else 1.0)
        size = min(math.sqrt(2 * limits.jerk * change), change / dt_s, most) / max(change, 1e-9)
        steps = north * size - self.acceleration[0], east * size - self.acceleration[1]
        scale = min(1.0, limits.jerk * dt_s / max(math.hypot(*steps), 1e-9))
        for axis in (0, 1):
            self.acceleration[axis] += steps[axis] * scale
            self.aim[axis] += self.acceleration[axis] * dt_s

    def _aim_up(self, wanted: float, limits: Limits, dt_s: float) -> None:
        change = wanted - self.aim[2]
        if abs(change) < 1e-9 and self.acceleration[2] == 0.0:
            return
        size = min(
            math.sqrt(2 * limits.jerk * abs(change)), abs(change) / dt_s, limits.up if change > 0 else limits.down
        )
        most = limits.jerk * dt_s
        self.acceleration[2] += max(-most, min(most, math.copysign(size, change) - self.acceleration[2]))
        self.aim[2] += self.acceleration[2] * dt_s

    def _facing(self) -> float:
        """The share of its acceleration that it has while it turns."""
        return 1.0 if abs(_wrapped(self.yaw_aim_rad - self.yaw_rad)) < math.radians(45) else 0.5

    def _turn(self, acceleration_rad_s2: float, dt_s: float) -> None:
        """Turn the heading to its aim, with that angular acceleration and at most at YAW_RATE_RAD_S."""
        left = _wrapped(self.yaw_aim_rad - self.yaw_rad)
        if left == 0.0 and self._yaw_rate == 0.0:
            return
        wanted = math.copysign(min(YAW_RATE_RAD_S, math.sqrt(2 * acceleration_rad_s2 * abs(left))), left)
        most = acceleration_rad_s2 * dt_s
        self._yaw_rate += max(-most, min(most, wanted - self._yaw_rate))
        if abs(left) <= most * dt_s * 2 and abs(self._yaw_rate) <= 2 * most:
            self.yaw_rad, self._yaw_rate = self.yaw_aim_rad, 0.0
        else:
            self.yaw_rad = _wrapped(self.yaw_rad + self._yaw_rate * dt_s)


def _wrapped(angle_rad: float) -> float:
    """The same angle between minus and plus half a turn."""
    return (angle_rad + math.pi) % math.tau - math.pi


def approach(distance_m: float, fastest_m_s: float, braking_m_s2: float, jerk_m_s3: float) -> float:
    """The speed towards a point `distance_m` away (both signed) from which the drone can still stop there.

    Braking keeps to the acceleration and the jerk, so that 2 d a = v^2 + v 4 a^2 / j.
    """
    ramp = 4 * braking_m_s2 * braking_m_s2 / jerk_m_s3
    speed = 0.5 * (math.sqrt(ramp * ramp + 8 * braking_m_s2 * abs(distance_m)) - ramp)
    return math.copysign(min(fastest_m_s, speed), distance_m)


class Energy(Protocol):
    """A battery: its remaining charge, and the power that flying takes."""

    power_w: float

    @property
    def remaining_pct(self) -> float: ...

    @property
    def voltage_v(self) -> float: ...

    def charge(self, percent: float) -> None:
        """Set the remaining charge."""

    def step(self, motion: Motion, armed: bool, flying: bool, dt_s: float) -> None: ...


@dataclass
class Battery:
    """Energy in watt-hours. Staying up drains most of it; climbing and moving add to that."""

    capacity_wh: float
    left_wh: float
    idle_w: float = IDLE_W
    hover_w: float = HOVER_W
    volts: tuple[float, float] = (14.0, 16.8)
    """Voltages when empty and when full."""
    power_w: float = field(init=False)

    def __post_init__(self) -> None:
        self.power_w = self.idle_w

    @property
    def remaining_pct(self) -> float:
        return max(0.0, 100.0 * self.left_wh / self.capacity_wh)

    @property
    def voltage_v(self) -> float:
        empty, full = self.volts
        return empty + (full - empty) * self.remaining_pct / 100

    def charge(self, percent: float) -> None:
        self.left_wh = self.capacity_wh * percent / 100

    def step(self, motion: Motion, armed: bool, flying: bool, dt_s: float) -> None:
        self.power_w = self.idle_w
        if flying:
            climbing = max(0.0, motion.velocity[2])
            self.power_w = self.hover_w + CLIMB_W_PER_M_S * climbing + CRUISE_W_PER_M_S * motion.groundspeed_m_s
        self.left_wh = max(0.0, self.left_wh - self.power_w * dt_s / 3600)


@dataclass
class SimulatedBattery:
    """PX4's simulated battery: armed, it drains in SIM_BAT_DRAIN seconds, but not below SIM_BAT_MIN_PCT; else full."""

    drain_s: float
    least_pct: float
    remaining_pct: float = 100.0
    power_w: float = 0.0
    _full_pct: float = 100.0

    @property
    def voltage_v(self) -> float:
        return 14.0 + 2.2 * self.remaining_pct / 100

    def charge(self, percent: float) -> None:
        self.remaining_pct = self._full_pct = percent

    def step(self, motion: Motion, armed: bool, flying: bool, dt_s: float) -> None:
        if not armed:
            self.remaining_pct = self._full_pct
        elif self.remaining_pct > self.least_pct:
            lost_pct = 100.0 * dt_s / max(dt_s, self.drain_s)
            self.remaining_pct = max(self.least_pct, self.remaining_pct - lost_pct)
