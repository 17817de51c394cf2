"""Makes the streamed messages from the autopilot's state; noise comes from a seed, so that runs repeat."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .autopilot import Autopilot
from .modes import Mode

GRAVITY_M_S2 = 9.80665
SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_GEOFENCE
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)


class Telemetry:
    """Messages by name, as the autopilot would stream them now."""

    def __init__(self, autopilot: Autopilot, seed: int) -> None:
        self._ap = autopilot
        self._random = random.Random(seed)
        self._pings = 0
        self._modes = itertools.cycle(enumerate(Mode, 1))

    def make(self, name: str) -> Any:
        """The message `name`; raises KeyError for one that is not streamed."""
        return _MAKERS[name](self)

    def _noise(self, size: float) -> float:
        return self._random.uniform(-size, size)

    def _boot_ms(self) -> int:
        return round(self._ap.now_s * 1000)

    def _usec(self) -> int:
        return round(self._ap.now_s * 1e6)

    def _tilt(self) -> tuple[float, float, float]:
        v = self._ap.motion.velocity
        yaw = self._ap.motion.yaw_rad
        forward = v[0] * math.cos(yaw) + v[1] * math.sin(yaw)
        return self._noise(0.01), -0.03 * forward + self._noise(0.01), yaw

    def _quaternion(self) -> list[float]:
        roll, pitch, yaw = (angle / 2 for angle in self._tilt())
        cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
        return [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]

    def _attitude(self) -> Any:
        rates = [self._noise(0.01) for _ in range(3)]
        return mavlink.MAVLink_attitude_message(self._boot_ms(), *self._tilt(), *rates)

    def _attitude_quaternion(self) -> Any:
        rates = [self._noise(0.01) for _ in range(3)]
        return mavlink.MAVLink_attitude_quaternion_message(self._boot_ms(), *self._quaternion(), *rates)

    def _global_position(self) -> Any:
        ap, place, v = self._ap, self._ap.guidance.place, self._ap.motion.velocity
        relative_mm = round((place.altitude_m - ap.guidance.home.altitude_m) * 1000)
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms(),
            *(round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)),
            *(round(place.altitude_m * 1000), relative_mm),
            *(round(v[0] * 100), round(v[1] * 100), round(-v[2] * 100), self._heading_cdeg()),
        )

    def _heading_cdeg(self) -> int:
        return round(math.degrees(self._ap.motion.yaw_rad) * 100) % 36_000

    def _local_position(self) -> Any:
        p, v = self._ap.motion.position, self._ap.motion.velocity
        return mavlink.MAVLink_local_position_ned_message(self._boot_ms(), p[0], p[1], -p[2], v[0], v[1], -v[2])

    def _imu(self) -> Any:
        acc = (self._noise(0.1), self._noise(0.1), -GRAVITY_M_S2 + self._noise(0.1))
        gyro = [self._noise(0.01) for _ in range(3)]
        mag = (0.21 + self._noise(0.002), 0.01 + self._noise(0.002), 0.43 + self._noise(0.002))
        height = self._ap.guidance.place.altitude_m
        return mavlink.MAVLink_highres_imu_message(
            self._usec(), *acc, *gyro, *mag, self._pressure_hpa(), 0.0, height, 25.0, 0x1DFF, 0
        )

    def _pressure_hpa(self) -> float:
        return float(1013.25 * (1 - self._ap.guidance.place.altitude_m / 44_330) ** 5.255)

    def _odometry(self) -> Any:
        p, v = self._ap.motion.position, self._ap.motion.velocity
        covariance = [0.01, *[0.0] * 5, 0.01, *[0.0] * 4, 0.01, *[0.0] * 3, 0.01, 0.0, 0.0, 0.01, 0.0, 0.01]
        rates = [self._noise(0.01) for _ in range(3)]
        return mavlink.MAVLink_odometry_message(
            *(self._usec(), mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD),
            *(p[0], p[1], -p[2], self._quaternion(), v[0], v[1], -v[2], *rates),
            *(covariance, covariance, 0, mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT, 100),
        )

    def _attitude_target(self) -> Any:
        thrust = 0.0 if self._ap.landed else 0.5 + self._noise(0.02)
        return mavlink.MAVLink_attitude_target_message(
            self._boot_ms(), 0, self._quaternion(), 0.0, 0.0, self._noise(0.01), thrust
        )

    def _position_target_local(self) -> Any:
        t = self._ap.guidance.target
        return mavlink.MAVLink_position_target_local_ned_message(
            self._boot_ms(), mavlink.MAV_FRAME_LOCAL_NED, 0, t[0], t[1], -t[2], 0, 0, 0, 0, 0, -0.1, 0, 0
        )

    def _position_target_global(self) -> Any:
        place = self._ap.guidance.origin.offset(*self._ap.guidance.target)
        return mavlink.MAVLink_position_target_global_int_message(
            self._boot_ms(),
            mavlink.MAV_FRAME_GLOBAL_INT,
            0,
            *(round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7), place.altitude_m),
            *(0, 0, 0, 0, 0, -0.1, 0, 0),
        )

    def _servo(self) -> Any:
        level = 900 if not self._ap.armed else 1100 if self._ap.landed else 1500
        motors = [level + self._random.randint(0, 40) if level > 1000 else level for _ in range(4)]
        return mavlink.MAVLink_servo_output_raw_message(self._usec() & 0xFFFFFFFF, 0, *motors, 0, 0, 0, 0)

    def _rc(self) -> Any:
        sticks = [1500, 1500, 1000, 1500, *[1000] * 4]
        return mavlink.MAVLink_rc_channels_message(self._boot_ms(), 8, *sticks, *[0] * 10, 255)

    def _gps(self) -> Any:
        place, speed = self._ap.guidance.place, self._ap.motion.groundspeed_m_s
        altitude_mm = round(place.altitude_m * 1000)
        return mavlink.MAVLink_gps_raw_int_message(
            *(self._usec(), mavlink.GPS_FIX_TYPE_3D_FIX),
            *(round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7), altitude_mm),
            *(70, 110, round(speed * 100), self._heading_cdeg(), 12),
            *(altitude_mm + 47_000, 700, 1100, 300, 0),
        )

    def _vfr_hud(self) -> Any:
        motion = self._ap.motion
        throttle = 0 if self._ap.landed else 50
        return mavlink.MAVLink_vfr_hud_message(
            *(motion.groundspeed_m_s, motion.groundspeed_m_s, self._heading_cdeg() // 100, throttle),
            *(self._ap.guidance.place.altitude_m, motion.velocity[2]),
        )

    def _altitude(self) -> Any:
        up = self._ap.motion.position[2]
        amsl = self._ap.guidance.place.altitude_m
        return mavlink.MAVLink_altitude_message(self._usec(), amsl, amsl, up, up - self._ap.guidance.home_up_m, up, up)

    def _nav(self) -> Any:
        t, p = self._ap.guidance.target, self._ap.motion.position
        distance = min(65_535, round(math.hypot(t[0] - p[0], t[1] - p[1])))
        roll, pitch, _ = self._tilt()
        bearing = round(math.degrees(math.atan2(t[1] - p[1], t[0] - p[0])))
        return mavlink.MAVLink_nav_controller_output_message(
            math.degrees(roll), math.degrees(pitch), bearing, bearing, distance, t[2] - p[2], 0.0, 0.0
        )

    def _sys_status(self) -> Any:
        health = SENSORS
        if not self._ap.healthy:
            health &= ~(mavlink.MAV_SYS_STATUS_SENSOR_GPS | mavlink.MAV_SYS_STATUS_PREARM_CHECK)
        battery = self._ap.battery
        current_ca = round(100 * battery.power_w / battery.voltage_v)
        return mavlink.MAVLink_sys_status_message(
            *(SENSORS, SENSORS, health, 250, round(battery.voltage_v * 1000), current_ca),
            *(round(battery.remaining_pct), 0, 0, 0, 0, 0, 0),
        )

    def _extended(self) -> Any:
        return mavlink.MAVLink_extended_sys_state_message(0, self._ap.landed_state)

    def _battery(self) -> Any:
        battery = self._ap.battery
        cells = [round(battery.voltage_v / 4 * 1000)] * 4 + [0xFFFF] * 6
        used_wh = battery.capacity_wh - battery.left_wh
        return mavlink.MAVLink_battery_status_message(
            *(0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO, 3000, cells),
            *(round(100 * battery.power_w / battery.voltage_v), round(used_wh * 1000 / battery.voltage_v)),
            *(round(used_wh * 36), round(battery.remaining_pct)),
            *(round(battery.left_wh / battery.power_w * 3600), mavlink.MAV_BATTERY_CHARGE_STATE_OK),
        )

    def _estimator(self) -> Any:
        ratios = [abs(self._noise(0.05)) for _ in range(4)]
        return mavlink.MAVLink_estimator_status_message(self._usec(), 831, *ratios, 0.0, 0.0, 0.3, 0.4)

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

    def _wind(self) -> Any:
        wind = (self._noise(0.5), self._noise(0.5), 0.0)
        return mavlink.MAVLink_wind_cov_message(
            self._usec(), *wind, 0.1, 0.0, self._ap.guidance.place.altitude_m, 0.5, 0.0
        )

    def _timesync(self) -> Any:
        return mavlink.MAVLink_timesync_message(0, self._usec() * 1000)

    def _system_time(self) -> Any:
        return mavlink.MAVLink_system_time_message(1_700_000_000_000_000 + self._usec(), self._boot_ms())

    def _ping(self) -> Any:
        self._pings += 1
        return mavlink.MAVLink_ping_message(self._usec(), self._pings, 0, 0)

    def _mission(self) -> Any:
        state = mavlink.MISSION_STATE_NO_MISSION
        return mavlink.MAVLink_mission_current_message(0, 0, state, 1 if self._ap.mode is Mode.MISSION else 2)

    def _current_mode(self) -> Any:
        mode = self._ap.mode
        return mavlink.MAVLink_current_mode_message(_STANDARD_MODES.get(mode, 0), mode.custom_mode, mode.custom_mode)

    def _available_modes(self) -> Any:
        """One of the modes, another one each time."""
        index, mode = next(self._modes)
        return mavlink.MAVLink_available_modes_message(
            *(len(Mode), index, _STANDARD_MODES.get(mode, 0), mode.custom_mode, 0, mode.name.title().encode())
        )


_STANDARD_MODES = {
    Mode.POSITION: mavlink.MAV_STANDARD_MODE_POSITION_HOLD,
    Mode.ALTITUDE: mavlink.MAV_STANDARD_MODE_ALTITUDE_HOLD,
    Mode.RETURN: mavlink.MAV_STANDARD_MODE_SAFE_RECOVERY,
    Mode.MISSION: mavlink.MAV_STANDARD_MODE_MISSION,
    Mode.LAND: mavlink.MAV_STANDARD_MODE_LAND,
    Mode.TAKEOFF: mavlink.MAV_STANDARD_MODE_TAKEOFF,
}
_MAKERS: dict[str, Callable[[Telemetry], Any]] = {
    "HEARTBEAT": lambda telemetry: telemetry._ap.heartbeat(),
    "HOME_POSITION": lambda telemetry: telemetry._ap.home_position(),
    "ATTITUDE": Telemetry._attitude,
    "ATTITUDE_QUATERNION": Telemetry._attitude_quaternion,
    "GLOBAL_POSITION_INT": Telemetry._global_position,
    "LOCAL_POSITION_NED": Telemetry._local_position,
    "HIGHRES_IMU": Telemetry._imu,
    "ODOMETRY": Telemetry._odometry,
    "ATTITUDE_TARGET": Telemetry._attitude_target,
    "POSITION_TARGET_LOCAL_NED": Telemetry._position_target_local,
    "POSITION_TARGET_GLOBAL_INT": Telemetry._position_target_global,
    "SERVO_OUTPUT_RAW": Telemetry._servo,
    "RC_CHANNELS": Telemetry._rc,
    "GPS_RAW_INT": Telemetry._gps,
    "VFR_HUD": Telemetry._vfr_hud,
    "ALTITUDE": Telemetry._altitude,
    "NAV_CONTROLLER_OUTPUT": Telemetry._nav,
    "SYS_STATUS": Telemetry._sys_status,
    "EXTENDED_SYS_STATE": Telemetry._extended,
    "BATTERY_STATUS": Telemetry._battery,
    "ESTIMATOR_STATUS": Telemetry._estimator,
    "GPS_GLOBAL_ORIGIN": Telemetry._origin,
    "SCALED_PRESSURE": Telemetry._pressure,
    "VIBRATION": Telemetry._vibration,
    "WIND_COV": Telemetry._wind,
    "TIMESYNC": Telemetry._timesync,
    "SYSTEM_TIME": Telemetry._system_time,
    "PING": Telemetry._ping,
    "MISSION_CURRENT": Telemetry._mission,
    "CURRENT_MODE": Telemetry._current_mode,
    "AVAILABLE_MODES": Telemetry._available_modes,
}
