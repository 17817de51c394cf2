"""PX4's parameters."""

from __future__ import annotations

from ..parameters import Spec

SPECS: dict[str, Spec] = {
    "BAT1_CAPACITY": Spec(-1.0, -1, 1_000_000),
    "COM_DISARM_LAND": Spec(2.0, -1, 20),
    "COM_DISARM_PRFLT": Spec(10.0, -1, 3600),
    "COM_OF_LOSS_T": Spec(1.0, 0, 60),
    "COM_SPOOLUP_TIME": Spec(1.0, 0, 30),
    "MAV_SYS_ID": Spec(1, 1, 250),
    "MAV_TYPE": Spec(2, 0, 22),
    "MIS_TAKEOFF_ALT": Spec(2.5, 0, 80),
    "MPC_ACC_DOWN_MAX": Spec(3.0, 2, 15),
    "MPC_ACC_HOR": Spec(3.0, 2, 15),
    "MPC_ACC_UP_MAX": Spec(4.0, 2, 15),
    "MPC_JERK_AUTO": Spec(4.0, 1, 80),
    "MPC_LAND_ALT1": Spec(10.0, 0, 100),
    "MPC_LAND_ALT2": Spec(5.0, 0, 100),
    "MPC_LAND_ALT3": Spec(1.0, 0, 100),
    "MPC_LAND_CRWL": Spec(0.3, 0.1, 2),
    "MPC_LAND_SPEED": Spec(0.7, 0.2, 3),
    "MPC_TKO_RAMP_T": Spec(3.0, 0, 5),
    "MPC_TKO_SPEED": Spec(1.5, 0.5, 5),
    "MPC_XY_CRUISE": Spec(5.0, 0.5, 20),
    "MPC_XY_VEL_MAX": Spec(12.0, 0.5, 20),
    "MPC_Z_VEL_MAX_DN": Spec(1.5, 0.5, 4),
    "MPC_Z_VEL_MAX_UP": Spec(3.0, 0.5, 8),
    "MPC_Z_V_AUTO_DN": Spec(1.5, 0.5, 4),
    "MPC_Z_V_AUTO_UP": Spec(3.0, 0.5, 8),
    "NAV_ACC_RAD": Spec(2.0, 0.05, 200),
    "NAV_DLL_ACT": Spec(0, 0, 6),
    "RTL_CONE_ANG": Spec(45, 0, 90),
    "RTL_MIN_DIST": Spec(10.0, 0.5, 100),
    "RTL_RETURN_ALT": Spec(30.0, 0, 1000),
    "SIM_BAT_DRAIN": Spec(60.0, 1, 86_400),
    "SIM_BAT_MIN_PCT": Spec(50.0, 0, 100),
    "SYS_AUTOSTART": Spec(10040, 0, 99_999_999),
}
"""Names, types and defaults as PX4 ships them (multicopter), in the order of their indices; ranges roughly PX4's."""
