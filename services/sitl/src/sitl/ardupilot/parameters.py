"""ArduCopter's parameters, and its counterparts of the fleet's."""

from __future__ import annotations

from ..errors import SitlError
from ..fleet import DroneConfig
from ..parameters import Spec

SPECS: dict[str, Spec] = {
    "BATT_CAPACITY": Spec(3300, 0, 1_000_000),
    "DISARM_DELAY": Spec(10, 0, 127),
    "FRAME_CLASS": Spec(1, 0, 17),
    "GUID_TIMEOUT": Spec(3.0, 0.1, 5),
    "LAND_ALT_LOW": Spec(1000.0, 100, 10_000),
    "LAND_SPEED": Spec(50, 30, 200),
    "LAND_SPEED_HIGH": Spec(0, 0, 500),
    "PILOT_ACCEL_Z": Spec(250, 50, 500),
    "PILOT_SPEED_UP": Spec(250, 50, 500),
    "PSC_JERK_XY": Spec(5.0, 1, 20),
    "PSC_JERK_Z": Spec(5.0, 5, 50),
    "RTL_ALT": Spec(1500, 30, 300_000),
    "RTL_CLIMB_MIN": Spec(0, 0, 3000),
    "RTL_CONE_SLOPE": Spec(3.0, 0, 10),
    "RTL_LOIT_TIME": Spec(5000, 0, 60_000),
    "RTL_SPEED": Spec(0, 0, 2000),
    "SYSID_THISMAV": Spec(1, 1, 255),
    "WPNAV_ACCEL": Spec(250.0, 50, 500),
    "WPNAV_ACCEL_Z": Spec(100.0, 50, 500),
    "WPNAV_SPEED": Spec(1000.0, 20, 2000),
    "WPNAV_SPEED_DN": Spec(150.0, 10, 500),
    "WPNAV_SPEED_UP": Spec(250.0, 10, 1000),
}
"""Names, types and defaults as ArduCopter has them with its simulator's copter.parm; centimetres, milliseconds."""
COUNTERPARTS: dict[str, tuple[str, float] | None] = {
    "COM_DISARM_PRFLT": ("DISARM_DELAY", 1.0),
    "RTL_RETURN_ALT": ("RTL_ALT", 100.0),
    "MPC_XY_CRUISE": ("WPNAV_SPEED", 100.0),
    "MPC_XY_VEL_MAX": None,
    "MIS_TAKEOFF_ALT": None,
}
"""ArduCopter's parameter for one of the fleet's, and the factor from PX4's unit to its own; None: it flies no faster
than it cruises, and every takeoff names its height."""


def of_fleet(config: DroneConfig) -> dict[str, float]:
    """A drone's parameters by ArduCopter's names; raises SitlError for one that has no counterpart."""
    values = {}
    for name, value in config.parameters.items():
        if name not in COUNTERPARTS:
            raise SitlError(f"drones.{config.system_id}.parameters.{name}: ArduCopter has no such parameter")
        counterpart = COUNTERPARTS[name]
        if counterpart is not None:
            own, factor = counterpart
            values[own] = value * factor
    return values
