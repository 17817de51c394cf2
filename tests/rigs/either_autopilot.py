"""A flight of a real PX4 or a real ArduCopter, whichever a test is for."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.rigs import copter, px4
from tests.rigs.real_flights import Flight


def flight_of(kind: str, folder: Path) -> Flight:
    """A flight of `px4` or `copter`, not begun yet; skips the test if the environment names no folder for it."""
    if kind == "px4":
        if not px4.FOLDER:
            pytest.skip("PX4_DIR names no folder with bin/px4 and etc of a PX4")
        flown = px4.Px4(folder)
        return Flight(folder, flown, px4.Px4Pilot(flown.pilots_port))
    if not copter.FOLDER:
        pytest.skip("ARDUPILOT_DIR names no folder with arducopter and copter.parm")
    other = copter.Copter(folder)
    return Flight(folder, other, copter.CopterPilot(other.pilots_port))
