"""The experiments' fleet with quicker drones, so that tests do not wait longer for a flight than necessary."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from testbed.plan.fleets import FLEET_FILE

LANDING = {
    **{"MPC_LAND_SPEED": 3, "MPC_LAND_CRWL": 1, "MPC_Z_VEL_MAX_DN": 4, "MPC_Z_V_AUTO_DN": 4},
    **{"MPC_ACC_UP_MAX": 10, "MPC_ACC_DOWN_MAX": 10, "MPC_JERK_AUTO": 40},
}
"""PX4's parameters for drones that descend in a third of the time."""
FLYING = {
    **LANDING,
    **{"MPC_TKO_RAMP_T": 0.5, "MPC_TKO_SPEED": 5, "MPC_Z_VEL_MAX_UP": 8, "MPC_Z_V_AUTO_UP": 8},
    **{"MPC_XY_VEL_MAX": 20, "MPC_XY_CRUISE": 20, "MPC_ACC_HOR": 10},
}
"""PX4's parameters for drones that fly a scenario in half the time."""


def quick_fleet(folder: Path, parameters: Mapping[str, float]) -> Path:
    """Write the fleet's file with these parameters for each drone into a folder, and return its path."""
    fleet = yaml.safe_load(FLEET_FILE.read_text())
    for drone in fleet["drones"].values():
        drone["parameters"] |= parameters
    path = folder / "quick-fleet.yaml"
    path.write_text(yaml.safe_dump(fleet))
    return path
