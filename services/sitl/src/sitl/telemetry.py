"""Makes the streamed messages from an autopilot's state; noise comes from a seed, so that runs repeat."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

from .autopilot import Autopilot
from .dynamics import Battery, Place
from .wander import Quiet, Wander


class Telemetry:
    """Makes messages by name, as the autopilot would stream them now; quiet ones have no noise.

    `makers` has a function for each message of the kind. `wanders` has, for each value, its standard deviations at
    rest and in flight (metres, metres per second, radians, volts) and their memory (seconds).
    """

    makers: ClassVar[Mapping[str, Callable[[Any], Any]]]
    wanders: ClassVar[Mapping[str, tuple[float, float, float]]]

    def __init__(self, autopilot: Autopilot, seed: int, *, quiet: bool = False) -> None:
        self._ap = autopilot
        self._quiet = quiet
        self._random = random.Random(seed)
        self._wanders = {
            name: Quiet() if quiet else Wander(self._random, *sizes) for name, sizes in self.wanders.items()
        }

    def make(self, name: str) -> Any:
        """Make the message `name`; None if it has no content now. Raises KeyError for one that is not streamed."""
        return self.makers[name](self)

    def _wander(self, name: str) -> float:
        return self._wanders[name].at(self._ap.now_s, not self._ap.landed)

    def _noise(self, size: float) -> float:
        return 0.0 if self._quiet else self._random.uniform(-size, size)

    def _boot_ms(self) -> int:
        return round(self._ap.now_s * 1000)

    def _usec(self) -> int:
        return round(self._ap.now_s * 1e6)

    def _position(self) -> tuple[float, float, float]:
        """The estimated position: north, east, up."""
        p = self._ap.motion.position
        return p[0] + self._wander("north"), p[1] + self._wander("east"), p[2] + self._wander("up")

    def _velocity(self) -> tuple[float, float, float]:
        v, error = self._ap.motion.velocity, self._wander("speed")
        return v[0] + error, v[1] - error, v[2] + self._wander("climb")

    def _place(self) -> Place:
        return self._ap.guidance.origin.offset(*self._position())

    def _home(self) -> Place:
        return self._ap.guidance.home

    def _yaw(self) -> float:
        return self._ap.motion.yaw_rad + self._wander("heading")

    def _tilt(self) -> tuple[float, float, float]:
        v, yaw = self._ap.motion.velocity, self._yaw()
        forward = v[0] * math.cos(yaw) + v[1] * math.sin(yaw)
        return self._wander("roll"), -0.03 * forward + self._noise(0.001), yaw

    def _rates(self) -> list[float]:
        return [self._noise(0.01) for _ in range(3)]

    def _quaternion(self) -> list[float]:
        roll, pitch, yaw = (angle / 2 for angle in self._tilt())
        cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
        return [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]

    def _home_position(self) -> Any:
        home, origin = self._home(), self._ap.guidance.origin
        north, east = origin.metres_to(home.latitude_deg, home.longitude_deg)
        return mavlink.MAVLink_home_position_message(
            latitude=round(home.latitude_deg * 1e7),
            longitude=round(home.longitude_deg * 1e7),
            altitude=round(home.altitude_m * 1000),
            x=north,
            y=east,
            z=origin.altitude_m - home.altitude_m,
            q=[1.0, 0.0, 0.0, 0.0],
            approach_x=0.0,
            approach_y=0.0,
            approach_z=0.0,
            time_usec=self._usec(),
        )

    def _attitude(self) -> Any:
        return mavlink.MAVLink_attitude_message(self._boot_ms(), *self._tilt(), *self._rates())

    def _attitude_quaternion(self) -> Any:
        return mavlink.MAVLink_attitude_quaternion_message(self._boot_ms(), *self._quaternion(), *self._rates())

    def _global_position(self) -> Any:
        place, v = self._place(), self._velocity()
        return mavlink.MAVLink_global_position_int_message(
            time_boot_ms=self._boot_ms(),
            lat=round(place.latitude_deg * 1e7),
            lon=round(place.longitude_deg * 1e7),
            alt=round(place.altitude_m * 1000),
            relative_alt=round((place.altitude_m - self._home().altitude_m) * 1000),
            vx=round(v[0] * 100),
            vy=round(v[1] * 100),
            vz=round(-v[2] * 100),
            hdg=self._heading_cdeg(),
        )

    def _heading_cdeg(self) -> int:
        return round(math.degrees(self._yaw()) * 100) % 36_000

    def _local_position(self) -> Any:
        p, v = self._position(), self._velocity()
        return mavlink.MAVLink_local_position_ned_message(self._boot_ms(), p[0], p[1], -p[2], v[0], v[1], -v[2])

    def _pressure_hpa(self) -> float:
        return float(1013.25 * (1 - self._place().altitude_m / 44_330) ** 5.255)

    def _position_target_local(self) -> Any:
        t = self._ap.guidance.target
        return mavlink.MAVLink_position_target_local_ned_message(
            self._boot_ms(), mavlink.MAV_FRAME_LOCAL_NED, 0, t[0], t[1], -t[2], 0, 0, 0, 0, 0, -0.1, 0, 0
        )

    def _position_target_global(self) -> Any:
        if not self._ap.has_target:
            return None
        place = self._ap.guidance.origin.offset(*self._ap.guidance.target)
        return mavlink.MAVLink_position_target_global_int_message(
            time_boot_ms=self._boot_ms(),
            coordinate_frame=mavlink.MAV_FRAME_GLOBAL_INT,
            type_mask=0,
            lat_int=round(place.latitude_deg * 1e7),
            lon_int=round(place.longitude_deg * 1e7),
            alt=place.altitude_m,
            vx=0,
            vy=0,
            vz=0,
            afx=0,
            afy=0,
            afz=-0.1,
            yaw=0,
            yaw_rate=0,
        )

    def _servo(self) -> Any:
        level = 900 if not self._ap.armed else 1100 if self._ap.landed else 1500
        motors = [level + self._random.randint(0, 40) if level > 1000 else level for _ in range(4)]
        idle = [900] * 12
        return mavlink.MAVLink_servo_output_raw_message(self._usec() & 0xFFFFFFFF, 0, *motors, *idle)

    def _rc(self) -> Any:
        sticks = [1500, 1500, 1000, 1500, *[1000] * 4]
        return mavlink.MAVLink_rc_channels_message(self._boot_ms(), 8, *sticks, *[0] * 10, 255)

    def _gps(self) -> Any:
        place, speed = self._place(), math.hypot(*self._velocity()[:2])
        altitude_mm = round(place.altitude_m * 1000)
        return mavlink.MAVLink_gps_raw_int_message(
            time_usec=self._usec(),
            fix_type=mavlink.GPS_FIX_TYPE_3D_FIX,
            lat=round(place.latitude_deg * 1e7),
            lon=round(place.longitude_deg * 1e7),
            alt=altitude_mm,
            eph=70,
            epv=110,
            vel=round(speed * 100),
            cog=self._heading_cdeg(),
            satellites_visible=12,
            alt_ellipsoid=altitude_mm + 47_000,
            h_acc=700,
            v_acc=1100,
            vel_acc=300,
            hdg_acc=0,
        )

    def _vfr_hud(self) -> Any:
        v = self._velocity()
        speed, throttle = math.hypot(v[0], v[1]), 0 if self._ap.landed else 50
        return mavlink.MAVLink_vfr_hud_message(
            airspeed=speed,
            groundspeed=speed,
            heading=self._heading_cdeg() // 100,
            throttle=throttle,
            alt=self._place().altitude_m,
            climb=v[2],
        )

    def _nav(self) -> Any:
        t, p = self._ap.guidance.target, self._ap.motion.position
        distance = min(65_535, round(math.hypot(t[0] - p[0], t[1] - p[1])))
        roll, pitch, _ = self._tilt()
        bearing = round(math.degrees(math.atan2(t[1] - p[1], t[0] - p[0])))
        return mavlink.MAVLink_nav_controller_output_message(
            math.degrees(roll), math.degrees(pitch), bearing, bearing, distance, t[2] - p[2], 0.0, 0.0
        )

    def _voltage_v(self) -> float:
        return self._ap.battery.voltage_v + self._wander("voltage")

    def _current_ca(self) -> int:
        battery = self._ap.battery
        return round(100 * battery.power_w / battery.voltage_v)

    def _status(self, present: int, enabled: int, health: int, load: int, **extended: int) -> Any:
        """SYS_STATUS without errors of links and sensors."""
        return mavlink.MAVLink_sys_status_message(
            onboard_control_sensors_present=present,
            onboard_control_sensors_enabled=enabled,
            onboard_control_sensors_health=health,
            load=load,
            voltage_battery=round(self._voltage_v() * 1000),
            current_battery=self._current_ca(),
            battery_remaining=round(self._ap.battery.remaining_pct),
            drop_rate_comm=0,
            errors_comm=0,
            errors_count1=0,
            errors_count2=0,
            errors_count3=0,
            errors_count4=0,
            **extended,
        )

    def _extended(self) -> Any:
        return mavlink.MAVLink_extended_sys_state_message(0, self._ap.landed_state)

    def _battery(self) -> Any:
        battery = self._ap.battery
        cells = [round(self._voltage_v() / 4 * 1000)] * 4 + [0xFFFF] * 6
        used_mah, used_hj, left_s = -1, -1, 0
        if isinstance(battery, Battery):
            used_wh = battery.capacity_wh - battery.left_wh
            used_mah, used_hj = round(used_wh * 1000 / battery.voltage_v), round(used_wh * 36)
            left_s = round(battery.left_wh / battery.power_w * 3600) if battery.power_w > 0 else 0
        return mavlink.MAVLink_battery_status_message(
            id=0,
            battery_function=mavlink.MAV_BATTERY_FUNCTION_ALL,
            type=mavlink.MAV_BATTERY_TYPE_LIPO,
            temperature=3000,
            voltages=cells,
            current_battery=self._current_ca(),
            current_consumed=used_mah,
            energy_consumed=used_hj,
            battery_remaining=round(battery.remaining_pct),
            time_remaining=left_s,
            charge_state=mavlink.MAV_BATTERY_CHARGE_STATE_OK,
        )

    def _origin(self) -> Any:
        origin = self._ap.guidance.origin
        return mavlink.MAVLink_gps_global_origin_message(
            round(origin.latitude_deg * 1e7),
            round(origin.longitude_deg * 1e7),
            round(origin.altitude_m * 1000),
            self._usec(),
        )

    def _pressure(self) -> Any:
        return mavlink.MAVLink_scaled_pressure_message(self._boot_ms(), self._pressure_hpa(), 0.0, 2500)

    def _vibration(self) -> Any:
        shaking = 0.1 if self._ap.landed else 3.0
        axes = [abs(self._noise(shaking)) for _ in range(3)]
        return mavlink.MAVLink_vibration_message(self._usec(), *axes, 0, 0, 0)

    def _system_time(self) -> Any:
        return mavlink.MAVLink_system_time_message(1_700_000_000_000_000 + self._usec(), self._boot_ms())


MAKERS: dict[str, Callable[[Any], Any]] = {
    "HOME_POSITION": Telemetry._home_position,
    "ATTITUDE": Telemetry._attitude,
    "ATTITUDE_QUATERNION": Telemetry._attitude_quaternion,
    "GLOBAL_POSITION_INT": Telemetry._global_position,
    "LOCAL_POSITION_NED": Telemetry._local_position,
    "POSITION_TARGET_LOCAL_NED": Telemetry._position_target_local,
    "POSITION_TARGET_GLOBAL_INT": Telemetry._position_target_global,
    "SERVO_OUTPUT_RAW": Telemetry._servo,
    "RC_CHANNELS": Telemetry._rc,
    "GPS_RAW_INT": Telemetry._gps,
    "VFR_HUD": Telemetry._vfr_hud,
    "NAV_CONTROLLER_OUTPUT": Telemetry._nav,
    "EXTENDED_SYS_STATE": Telemetry._extended,
    "BATTERY_STATUS": Telemetry._battery,
    "GPS_GLOBAL_ORIGIN": Telemetry._origin,
    "SCALED_PRESSURE": Telemetry._pressure,
    "VIBRATION": Telemetry._vibration,
    "SYSTEM_TIME": Telemetry._system_time,
}
"""The messages that all kinds fill alike."""
