"""Messages that PX4 fills in its own way."""

from __future__ import annotations

import itertools
import math
from typing import Any, ClassVar

from pymavlink.dialects.v20 import development as mavlink

from ..autopilot import FlightMode
from ..dynamics import GRAVITY_M_S2, Place
from ..telemetry import MAKERS, Telemetry
from ..unnamed import Unnamed
from .autopilot import Px4
from .modes import Mode

SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_GEOFENCE
)
HOME_M = 0.25
"""Home's height is not corrected for a smaller change of its error."""
_EXTENDED = mavlink.MAV_SYS_STATUS_RECOVERY_SYSTEM
HOME_S = 2.0
"""The interval at which home's height is corrected in flight."""


class Px4Telemetry(Telemetry):
    """PX4's messages, and how its estimates wander."""

    _ap: Px4
    wanders: ClassVar = {
        "north": (0.04, 0.26, 8.0),
        "east": (0.04, 0.26, 8.0),
        "up": (0.004, 0.11, 5.0),
        "climb": (0.005, 0.12, 0.5),
        "speed": (0.012, 0.1, 1.0),
        "heading": (0.0015, 0.0028, 3.0),
        "roll": (0.001, 0.02, 0.3),
        "voltage": (0.0, 0.06, 0.3),
        "home": (0.0, 0.45, 3.0),
    }

    def __init__(self, autopilot: Px4, seed: int, *, quiet: bool = False) -> None:
        super().__init__(autopilot, seed, quiet=quiet)
        self._home_error_m, self._home_s = 0.0, -math.inf
        self._modes = itertools.cycle(enumerate(Mode, 1))
        self._pings = 0
        self._sent = 0

    def make(self, name: str) -> Any:
        self._sent += 1
        return super().make(name)

    def _home(self) -> Place:
        """Home, whose height PX4 corrects in flight as its estimate of the height changes."""
        home, now_s = self._ap.guidance.home, self._ap.now_s
        if now_s - self._home_s >= HOME_S:
            self._home_s, error_m = now_s, self._wander("home")
            if abs(error_m - self._home_error_m) > HOME_M:
                self._home_error_m = error_m
        return Place(home.latitude_deg, home.longitude_deg, home.altitude_m + self._home_error_m)

    def _heartbeat(self) -> Any:
        ap = self._ap
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if ap.armed else 0)
        state = mavlink.MAV_STATE_ACTIVE if ap.armed else mavlink.MAV_STATE_STANDBY
        if ap.failsafe:
            state = mavlink.MAV_STATE_CRITICAL
        kind = int(ap.parameters["MAV_TYPE"])
        return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_PX4, base, ap.mode.custom_mode, state, 3)

    def _sys_status(self) -> Any:
        """PX4 sets PREARM_CHECK in health alone, never in present."""
        health = SENSORS & ~mavlink.MAV_SYS_STATUS_SENSOR_GPS
        if self._ap.healthy:
            health = SENSORS | mavlink.MAV_SYS_STATUS_PREARM_CHECK
        return self._status(
            SENSORS,
            SENSORS,
            health,
            load=250,
            onboard_control_sensors_present_extended=_EXTENDED,
            onboard_control_sensors_enabled_extended=_EXTENDED,
            onboard_control_sensors_health_extended=_EXTENDED,
        )

    def _current_ca(self) -> int:
        """-1 A for a battery whose current is not measured."""
        return super()._current_ca() if self._ap.battery.power_w > 0 else -100

    def _imu(self) -> Any:
        acc = (self._noise(0.1), self._noise(0.1), -GRAVITY_M_S2 + self._noise(0.1))
        gyro = [self._noise(0.01) for _ in range(3)]
        mag = (0.21 + self._noise(0.002), 0.01 + self._noise(0.002), 0.43 + self._noise(0.002))
        height = self._place().altitude_m
        return mavlink.MAVLink_highres_imu_message(
            self._usec(), *acc, *gyro, *mag, self._pressure_hpa(), 0.0, height, 25.0, 0x1DFF, 0
        )

    def _odometry(self) -> Any:
        p, v, q = self._position(), self._velocity(), self._quaternion()
        roll, pitch, yaw = self._rates()
        return mavlink.MAVLink_odometry_message(
            time_usec=self._usec(),
            frame_id=mavlink.MAV_FRAME_LOCAL_NED,
            child_frame_id=mavlink.MAV_FRAME_BODY_FRD,
            x=p[0],
            y=p[1],
            z=-p[2],
            q=q,
            vx=v[0],
            vy=v[1],
            vz=-v[2],
            rollspeed=roll,
            pitchspeed=pitch,
            yawspeed=yaw,
            pose_covariance=_COVARIANCE,
            velocity_covariance=_COVARIANCE,
            reset_counter=0,
            estimator_type=mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
            quality=0,
        )

    def _attitude_target(self) -> Any:
        thrust = 0.01 if self._ap.landed else 0.5 + self._noise(0.02)
        return mavlink.MAVLink_attitude_target_message(
            self._boot_ms(), 0, self._quaternion(), 0.0, 0.0, self._noise(0.01), thrust
        )

    def _altitude(self) -> Any:
        up, place = self._position()[2], self._place()
        above_home = place.altitude_m - self._home().altitude_m
        amsl = place.altitude_m
        return mavlink.MAVLink_altitude_message(self._usec(), amsl, amsl, up, above_home, up, max(0.01, up))

    def _estimator(self) -> Any:
        ratios = [abs(self._noise(0.05)) for _ in range(4)]
        return mavlink.MAVLink_estimator_status_message(self._usec(), 831, *ratios, 0.0, 0.0, 0.3, 0.4)

    def _wind(self) -> Any:
        wind = (self._noise(0.5), self._noise(0.5), 0.0)
        return mavlink.MAVLink_wind_cov_message(self._usec(), *wind, 0.1, 0.0, self._place().altitude_m, 0.5, 0.0)

    def _timesync(self) -> Any:
        return mavlink.MAVLink_timesync_message(0, self._usec() * 1000)

    def _ping(self) -> Any:
        self._pings += 1
        return mavlink.MAVLink_ping_message(self._usec(), self._pings, 0, 0)

    def _distance(self) -> Any:
        """The distance to the ground, by the sensor of PX4's simulation."""
        height_cm = max(2, min(40_00, round(self._position()[2] * 100)))
        down = mavlink.MAV_SENSOR_ROTATION_PITCH_270
        return mavlink.MAVLink_distance_sensor_message(
            self._boot_ms(), 2, 40_00, height_cm, mavlink.MAV_DISTANCE_SENSOR_LASER, 0, down, 0
        )

    def _open_drone_id_location(self) -> Any:
        place, v = self._place(), self._velocity()
        flies = mavlink.MAV_ODID_STATUS_GROUND if self._ap.landed else mavlink.MAV_ODID_STATUS_AIRBORNE
        above_home = place.altitude_m - self._home().altitude_m
        return mavlink.MAVLink_open_drone_id_location_message(
            target_system=0,
            target_component=0,
            id_or_mac=_NO_ID,
            status=flies,
            direction=self._heading_cdeg(),
            speed_horizontal=round(math.hypot(v[0], v[1]) * 100),
            speed_vertical=round(v[2] * 100),
            latitude=round(place.latitude_deg * 1e7),
            longitude=round(place.longitude_deg * 1e7),
            altitude_barometric=place.altitude_m,
            altitude_geodetic=place.altitude_m,
            height_reference=mavlink.MAV_ODID_HEIGHT_REF_OVER_TAKEOFF,
            height=above_home,
            horizontal_accuracy=11,
            vertical_accuracy=5,
            barometer_accuracy=4,
            speed_accuracy=4,
            timestamp=self._ap.now_s % 3600,
            timestamp_accuracy=1,
        )

    def _open_drone_id_system(self) -> Any:
        home = self._home()
        return mavlink.MAVLink_open_drone_id_system_message(
            target_system=0,
            target_component=0,
            id_or_mac=_NO_ID,
            operator_location_type=mavlink.MAV_ODID_OPERATOR_LOCATION_TYPE_TAKEOFF,
            classification_type=0,
            operator_latitude=round(home.latitude_deg * 1e7),
            operator_longitude=round(home.longitude_deg * 1e7),
            area_count=1,
            area_radius=0,
            area_ceiling=-1000.0,
            area_floor=-1000.0,
            category_eu=0,
            class_eu=0,
            operator_altitude_geo=home.altitude_m,
            timestamp=0,
        )

    def _mission(self) -> Any:
        """The current item, and the number of items: 65535 without a mission."""
        ap = self._ap
        total, flies = len(ap.plans.mission), ap.mode is Mode.MISSION
        state = mavlink.MISSION_STATE_NO_MISSION
        if total:
            state = mavlink.MISSION_STATE_ACTIVE if flies else mavlink.MISSION_STATE_NOT_STARTED
        seq = min(ap.plans.current, max(0, total - 1))
        return mavlink.MAVLink_mission_current_message(seq, total or 0xFFFF, state, 1 if flies else 2)

    def _current_mode(self) -> Any:
        mode = self._ap.mode
        return mavlink.MAVLink_current_mode_message(_STANDARD_MODES.get(mode, 0), mode.custom_mode, mode.custom_mode)

    def _available_modes(self) -> Any:
        """One of the modes, the next one each time."""
        index, mode = next(self._modes)
        return mavlink.MAVLink_available_modes_message(
            number_modes=len(Mode),
            mode_index=index,
            standard_mode=_STANDARD_MODES.get(mode, 0),
            custom_mode=mode.custom_mode,
            properties=0,
            mode_name=mode.name.title().encode(),
        )

    def _link(self) -> Any:
        return Unnamed("LINK_NODE_STATUS", (self._usec(), 25_000, 100, self._sent, 1, 0, 0, 0, 0, 0, 0))

    def _time_estimate(self) -> Any:
        return Unnamed("TIME_ESTIMATE_TO_TARGET", (-1, -1, -1, -1, -1))

    def _event_sequence(self) -> Any:
        return Unnamed("CURRENT_EVENT_SEQUENCE", (7, 0))

    makers: ClassVar = {
        **MAKERS,
        "HEARTBEAT": _heartbeat,
        "SYS_STATUS": _sys_status,
        "HIGHRES_IMU": _imu,
        "ODOMETRY": _odometry,
        "ATTITUDE_TARGET": _attitude_target,
        "ALTITUDE": _altitude,
        "ESTIMATOR_STATUS": _estimator,
        "WIND_COV": _wind,
        "TIMESYNC": _timesync,
        "PING": _ping,
        "DISTANCE_SENSOR": _distance,
        "OPEN_DRONE_ID_LOCATION": _open_drone_id_location,
        "OPEN_DRONE_ID_SYSTEM": _open_drone_id_system,
        "MISSION_CURRENT": _mission,
        "CURRENT_MODE": _current_mode,
        "AVAILABLE_MODES": _available_modes,
        "LINK_NODE_STATUS": _link,
        "TIME_ESTIMATE_TO_TARGET": _time_estimate,
        "CURRENT_EVENT_SEQUENCE": _event_sequence,
    }


_NO_ID = [0] * 20
_COVARIANCE = [0.01, *[0.0] * 5, 0.01, *[0.0] * 4, 0.01, *[0.0] * 3, 0.01, 0.0, 0.0, 0.01, 0.0, 0.01]
_STANDARD_MODES: dict[FlightMode, int] = {
    Mode.POSITION: mavlink.MAV_STANDARD_MODE_POSITION_HOLD,
    Mode.ALTITUDE: mavlink.MAV_STANDARD_MODE_ALTITUDE_HOLD,
    Mode.RETURN: mavlink.MAV_STANDARD_MODE_SAFE_RECOVERY,
    Mode.MISSION: mavlink.MAV_STANDARD_MODE_MISSION,
    Mode.LAND: mavlink.MAV_STANDARD_MODE_LAND,
    Mode.TAKEOFF: mavlink.MAV_STANDARD_MODE_TAKEOFF,
}
