"""A real PX4 as a process on loopback, and its modes."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import ClassVar

from pymavlink.dialects.v20 import common as mavlink

from sitl.fleet import ZURICH, DroneConfig
from sitl.process import LinkConfig
from sitl.real.px4 import Px4 as Prepared
from tests.rigs.processes import free_port
from tests.rigs.real_flights import SYSTEM, Autopilot, Pilot

FOLDER = os.environ.get("PX4_DIR", "")
"""A build of PX4: a folder with bin/px4 and etc."""
HOLD, RETURN, LAND, TAKEOFF, OFFBOARD = (4, 3), (4, 5), (4, 6), (4, 2), (6, 0)


class Px4(Autopilot):
    """PX4 in a folder of its own; each start is fresh, with default parameters."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "px4")
        onboard = LinkConfig(("127.0.0.1", free_port(socket.SOCK_DGRAM)), ("127.0.0.1", self.port), "px4-onboard")
        config = DroneConfig(SYSTEM, ZURICH, parameters={"MPC_XY_CRUISE": 5.0})
        work, logs = folder / "px4", folder / "flight-logs"
        self._prepared = Prepared(Path(FOLDER).resolve(), work, logs, config, onboard, self.pilots_port)

    def start(self) -> None:
        words, environment = self._prepared.prepare()
        self._run(words, self._prepared.work, environment)


class Px4Pilot(Pilot):
    landing: ClassVar = LAND

    @property
    def mode(self) -> tuple[int, int]:
        return self.custom_mode >> 16 & 0xFF, self.custom_mode >> 24 & 0xFF

    def set_mode(self, mode: tuple[int, int]) -> None:
        self.command(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *mode)
