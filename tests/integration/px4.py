"""A real PX4 with its own simulator, as a process on loopback, and a pilot's station on its second link."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
from pathlib import Path
from typing import Self

from copter import Pilot
from processes import free_port, wait_until
from pymavlink.dialects.v20 import common as mavlink

from sitl.fleet import ZURICH, DroneConfig
from sitl.process import LinkConfig
from sitl.real.px4 import Px4 as Prepared

FOLDER = os.environ.get("PX4_DIR", "")
"""A build of PX4: a folder with bin/px4 and etc."""
HOLD, RETURN, LAND, TAKEOFF, OFFBOARD = (4, 3), (4, 5), (4, 6), (4, 2), (6, 0)


class Px4:
    """PX4 in a folder of its own; each start is a new one, with its parameters' defaults."""

    def __init__(self, folder: Path, system: int) -> None:
        self.port, self.pilots_port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
        self._log = folder / "px4.log"
        onboard = LinkConfig(("127.0.0.1", free_port(socket.SOCK_DGRAM)), ("127.0.0.1", self.port), "px4-onboard")
        config = DroneConfig(system, ZURICH, parameters={"MPC_XY_CRUISE": 5.0})
        work, logs = folder / "px4", folder / "flight-logs"
        self._prepared = Prepared(Path(FOLDER).resolve(), work, logs, config, onboard, self.pilots_port)
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> Self:
        words, environment = self._prepared.prepare()
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=self._prepared.work, env=environment
            )
        return self

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


class Station(Pilot):
    """A pilot's station, to which PX4's own messages are the truth."""

    def set_px4_mode(self, mode: tuple[int, int]) -> None:
        self.command(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *mode)

    def set_whole_parameter(self, name: str, value: int) -> None:
        """PX4's whole numbers travel as the bits of a float."""
        bits = struct.unpack("<f", struct.pack("<i", value))[0]
        self.set_parameter(name, bits, mavlink.MAV_PARAM_TYPE_INT32)

    @property
    def px4_mode(self) -> tuple[int, int]:
        return self.mode >> 16 & 0xFF, self.mode >> 24 & 0xFF

    @property
    def would_arm(self) -> bool:
        """PX4's own verdict."""
        return bool(self.latest["SYS_STATUS"].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)

    @property
    def landed(self) -> bool:
        return bool(self.latest["EXTENDED_SYS_STATE"].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    def watch_health(self) -> None:
        def asked() -> bool:
            self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_SYS_STATUS, 2e5)
            return "SYS_STATUS" in self.latest

        wait_until(asked, "PX4's SYS_STATUS")
