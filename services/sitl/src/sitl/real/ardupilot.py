"""An ArduCopter prepared for its start: its parameters in a file, its place and links on its command line."""

from __future__ import annotations

import os
from collections.abc import Mapping

from ..ardupilot.parameters import of_fleet
from ..errors import SitlError
from .autopilot import Autopilot

PROGRAM, DEFAULTS = "arducopter", "copter.parm"
"""The contents of ArduCopter's folder: the program for SITL, and a copter's parameters from ArduPilot's sources."""
OWN: dict[str, float] = {
    "FLTMODE_CH": 0,  # nobody holds sticks, nor the simulation's mode switch
    "INITIAL_MODE": 4,  # GUIDED, in which it arms only where it could take off
}
"""The parameters that every ArduCopter here gets besides the fleet's."""


class ArduCopter(Autopilot):
    """One ArduCopter; its folder has arducopter and copter.parm.

    On both links it sends only requested messages: `onboard.streams` is for PX4.
    """

    def prepare(self) -> tuple[list[str], dict[str, str]]:
        parameters = self.work / "fleet.parm"
        lines = [f"{name} {value:g}\n" for name, value in {**OWN, **of_fleet(self.config)}.items()]
        try:
            self._make_folders("logs")
            parameters.write_text("".join(lines), encoding="utf-8")
        except OSError as error:
            raise SitlError(f"{error.filename}: {error.strerror}") from error
        number, home, (host, port) = str(self.config.system_id), self.config.home, self.onboard.send
        place = f"{home.latitude_deg:.7f},{home.longitude_deg:.7f},{home.altitude_m:.2f},0"
        given = self.folder.absolute()
        words = [str(given / PROGRAM), "--model", "quad", "--instance", number, "--sysid", number, "--wipe"]
        words += ["--defaults", f"{given / DEFAULTS},{parameters.absolute()}", "--home", place]
        words += ["--serial0", f"udpclient:{host}:{port}", "--serial1", f"udpclient:127.0.0.1:{self.witness}"]
        return words, dict(os.environ)

    def questions(self) -> dict[str, list[str]]:
        """None: it has no command that reads a parameter back."""
        return {}

    def check(self, answers: Mapping[str, str]) -> None:
        """Nothing was asked."""
