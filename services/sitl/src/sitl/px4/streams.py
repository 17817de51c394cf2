"""PX4's streams and their rates, by its own sets."""

from __future__ import annotations

from pymavlink.dialects.v20 import development as mavlink

RATES_HZ: dict[str, tuple[float, float, float]] = {
    "HEARTBEAT": (1, 1, 1),
    "ATTITUDE": (100, 15, 50),
    "ATTITUDE_QUATERNION": (50, 10, 50),
    "GLOBAL_POSITION_INT": (50, 5, 50),
    "LOCAL_POSITION_NED": (30, 1, 50),
    "HIGHRES_IMU": (50, 0, 0),
    "ODOMETRY": (30, 0, 0),
    "ATTITUDE_TARGET": (10, 2, 50),
    "POSITION_TARGET_LOCAL_NED": (10, 1.5, 50),
    "POSITION_TARGET_GLOBAL_INT": (10, 1, 1),
    "SERVO_OUTPUT_RAW": (10, 1, 50),
    "GPS_RAW_INT": (8, 5, 5),
    "VFR_HUD": (10, 4, 4),
    "ALTITUDE": (10, 1, 1),
    "DISTANCE_SENSOR": (10, 0.5, 0.5),
    "SYS_STATUS": (5, 1, 1),
    "EXTENDED_SYS_STATE": (5, 1, 1),
    "BATTERY_STATUS": (0.5, 0.5, 0.5),
    "HOME_POSITION": (0.5, 0.5, 0.5),
    "CURRENT_MODE": (0.5, 0.5, 0.5),
    "ESTIMATOR_STATUS": (1, 0.5, 0.5),
    "SCALED_PRESSURE": (1, 1, 1),
    "VIBRATION": (0.5, 0.1, 0.1),
    "TIMESYNC": (10, 0, 0),
    "SYSTEM_TIME": (1, 0, 0),
    "PING": (1, 0.1, 0.1),
    "MISSION_CURRENT": (1, 1, 1),
    "OPEN_DRONE_ID_LOCATION": (1, 1, 1),
    "OPEN_DRONE_ID_SYSTEM": (1, 1, 1),
    "LINK_NODE_STATUS": (1, 1, 1),
    "TIME_ESTIMATE_TO_TARGET": (0.5, 0.5, 0.5),
    "CURRENT_EVENT_SEQUENCE": (0.35, 0.35, 0.35),
    "RC_CHANNELS": (0, 0, 0),
    "NAV_CONTROLLER_OUTPUT": (0, 0, 0),
    "GPS_GLOBAL_ORIGIN": (0, 0, 0),
    "AVAILABLE_MODES": (0, 0, 0),
    "WIND_COV": (0, 0, 0),
}
"""Hz in PX4's sets onboard, normal and gcs, as its main sends them; POSITION_TARGET_GLOBAL_INT in automatic modes only.

The last ones, 0 in every set, are sent only on request.
"""
SILENT = frozenset(
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    for name in (
        *("ADSB_VEHICLE", "CAMERA_TRIGGER", "CAMERA_IMAGE_CAPTURED", "EFI_STATUS"),
        *("GIMBAL_DEVICE_ATTITUDE_STATUS", "GIMBAL_MANAGER_STATUS", "GPS2_RAW", "GPS_STATUS", "HYGROMETER_SENSOR"),
        *("MOUNT_ORIENTATION", "OBSTACLE_DISTANCE", "OPTICAL_FLOW_RAD", "ORBIT_EXECUTION_STATUS", "RAW_RPM"),
        *("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"),
    )
)
"""Messages whose interval PX4 accepts, although nothing here makes it send them."""

PX4_SETS = ("px4-onboard", "px4-normal", "px4-gcs")
SETS = (*PX4_SETS, "five-states")
"""`five-states` begins with heartbeats alone: further messages are requested by SET_MESSAGE_INTERVAL."""


def rates_hz(chosen: str) -> dict[str, float]:
    """The rate of each message in one of SETS, in Hz; 0 if it is not in the set."""
    if chosen in PX4_SETS:
        return {name: rates[PX4_SETS.index(chosen)] for name, rates in RATES_HZ.items()}
    return {name: 1.0 if name == "HEARTBEAT" else 0.0 for name in RATES_HZ}
