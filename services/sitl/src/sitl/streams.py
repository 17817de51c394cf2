"""What is streamed at which rate, after PX4's own sets, and when each message is due."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import development as mavlink

from .unnamed import NUMBERS

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
"""Hz in PX4's sets onboard, normal and gcs, as its main says them; POSITION_TARGET_GLOBAL_INT in automatic modes only.

The last ones it has, and says them where somebody asks for them.
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
"""Messages that PX4 takes an interval for, although nothing makes it say them here."""

FASTEST_HZ = 100.0
"""As fast as the stand-in's clock ticks."""
LATE_S = 0.1
"""What fell due so long ago is still sent; what is older is left out, as after a standstill.

So 45 messages come at once at the most, which a router's queue of 64 takes.
"""
PX4_SETS = ("px4-onboard", "px4-normal", "px4-gcs")
SETS = (*PX4_SETS, "five-states")
"""`five-states` begins with heartbeats: whoever wants more asks for it by SET_MESSAGE_INTERVAL."""
NAMES = {NUMBERS.get(name) or getattr(mavlink, f"MAVLINK_MSG_ID_{name}"): name for name in RATES_HZ}


def rates_hz(chosen: str) -> dict[str, float]:
    """Hz of each message in one of SETS; 0 where it is not in it."""
    if chosen in PX4_SETS:
        return {name: rates[PX4_SETS.index(chosen)] for name, rates in RATES_HZ.items()}
    return {name: 1.0 if name == "HEARTBEAT" else 0.0 for name in RATES_HZ}


class Streams:
    """The messages of one link and their rates."""

    def __init__(self, chosen: str) -> None:
        self._default_hz = rates_hz(chosen)
        self._hz = dict(self._default_hz)
        self._next_s = {name: i / len(RATES_HZ) / max(hz, 1) for i, (name, hz) in enumerate(self._hz.items())}
        """When each is due next; apart from each other, so that they do not all fall on one tick."""

    def due(self, now_s: float) -> list[str]:
        """The names of the messages to send now; one that fell due twice since the last call is there twice.

        So a busy machine, on which this is called late now and then, does not make the streams slower.
        """
        found = []
        for name, hz in self._hz.items():
            if hz <= 0:
                continue
            if now_s - self._next_s[name] > max(LATE_S, 1 / hz):
                self._next_s[name] = now_s
            while self._next_s[name] <= now_s:
                found.append(name)
                self._next_s[name] += 1 / hz
        return found

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL, at once: -1 stops, 0 is the default, else microseconds. False for an unknown one."""
        name = NAMES.get(message_id)
        if name is None or not math.isfinite(interval_us):
            return message_id in SILENT and math.isfinite(interval_us)
        self._next_s[name] = -math.inf  # so late that it is sent now, once
        if interval_us < 0:
            self._hz[name] = 0.0
        elif interval_us == 0:
            self._hz[name] = self._default_hz[name]
        else:
            self._hz[name] = min(1e6 / interval_us, FASTEST_HZ)
        return True

    def interval_us(self, message_id: int) -> int:
        """GET_MESSAGE_INTERVAL: -1 stopped, 0 unknown."""
        name = NAMES.get(message_id)
        if name is None:
            return 0
        return round(1e6 / self._hz[name]) if self._hz[name] > 0 else -1
