"""A real ArduCopter as a process on loopback, and its modes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import ClassVar

from pymavlink.dialects.v20 import common as mavlink

from tests.rigs.processes import free_block
from tests.rigs.real_flights import HOME, SYSTEM, Autopilot, Pilot

FOLDER = os.environ.get("ARDUPILOT_DIR", "")
"""A folder with `arducopter` and `copter.parm`."""
GUIDED, LOITER, LAND, RTL, BRAKE = 4, 5, 9, 6, 17
_PORTS_EACH = 10


class Copter(Autopilot):
    """ArduCopter in a folder of its own; it keeps its parameters there over a restart."""

    def __init__(self, folder: Path, *, by_usb: bool = True) -> None:
        """`by_usb`: the client is on SERIAL0, where unsigned messages count too, and the pilot on SERIAL1."""
        super().__init__(folder, "arducopter")
        self._serials = (0, 1) if by_usb else (1, 0)
        self._folder = folder
        self._base_port = free_block(_PORTS_EACH)
        self._more = folder / "more.parm"
        self._more.write_text("FLTMODE_CH 0\nINITIAL_MODE 4\n")  # its simulated remote control has a mode switch
        self._wiped: list[str] = ["--wipe"]

    def start(self) -> None:
        given = Path(FOLDER).resolve()
        words = [str(given / "arducopter"), "--model", "quad", "--home", ",".join(map(str, (*HOME, 0)))]
        words += ["--sysid", str(SYSTEM), "--defaults", f"{given / 'copter.parm'},{self._more}", *self._wiped]
        words += ["--base-port", str(self._base_port), "--rc-in-port", str(self._base_port + 8)]
        words += ["--irlock-port", str(self._base_port + 9)]
        for number, port in zip(self._serials, (self.port, self.pilots_port), strict=True):
            words += [f"--serial{number}", f"udpclient:127.0.0.1:{port}"]
        self._run(words, self._folder)
        self._wiped = []


class CopterPilot(Pilot):
    landing: ClassVar = LAND

    @property
    def mode(self) -> int:
        return self.custom_mode

    def set_mode(self, mode: int) -> None:
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)
