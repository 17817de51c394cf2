"""A PX4 of any version prepared for its start, by the hooks of its own start script.

`rcS` looks for `px4-rc.params` (up to 1.15) and `px4-rc.mavlink` on the PATH, and sets parameters from PX4_PARAM_* in
its environment (from 1.16 on): both are given, and the parameters are read back. PX4's folder is only read.
"""

from __future__ import annotations

import json
import lzma
import os
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..errors import SitlError
from .autopilot import Autopilot

MODEL = "sihsim_quadx"
"""PX4's own simulator in its own process, a quadrotor."""
STEP_S, STEPS, MOST_FACTOR = 0.004, 250, 1.12
"""PX4's simulator sleeps in each step, and a sleep takes longer than requested. The length and number of the sleeps
that are measured before PX4 starts, and the largest speed factor to make up for it. The witness measures the result.
"""
PARAMETERS = Path("etc/extras/parameters.json.xz")
"""The build's description of each parameter, in PX4's folder."""
OWN: dict[str, float] = {
    "COM_RC_IN_MODE": 4,  # nobody holds sticks
    "NAV_DLL_ACT": 0,  # nor does a ground station have to be connected
    "SDLOG_MODE": 2,  # the flight log lasts from boot to shutdown, past a first disarming
    "SDLOG_PROFILE": 1,  # and has what analyses need; by default a simulation logs for estimator replays, too
}
"""The parameters that every PX4 here gets besides the fleet's."""
RATE_B_S = 4_000_000
STREAMS = {
    "px4-onboard": ("onboard", {}),
    "px4-normal": ("normal", {}),
    "px4-gcs": (
        "normal",
        {
            **dict.fromkeys(("POSITION_TARGET_LOCAL_NED", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"), 50),
            **dict.fromkeys(("ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET", "SERVO_OUTPUT_RAW_0"), 50),
            "RC_CHANNELS": 20,
        },
    ),
    "five-states": ("custom", {"HEARTBEAT": 1}),
}
"""PX4's MAVLink modes, and streams in Hz on top, as its own start script has them."""
WITNESS_HEARTBEAT_HZ = 50
_COMMAND = re.compile(r"px4-(\w+) --instance")
_CLOSE = 1e-4
"""PX4 shows four decimals."""


def speed_factor(sleep: Callable[[float], None] = time.sleep, clock: Callable[[], float] = time.perf_counter) -> float:
    """How many times longer than requested the sleeps of one step take here, together; 1 to MOST_FACTOR."""
    began_s = clock()
    for _ in range(STEPS):
        sleep(STEP_S)
    return min(MOST_FACTOR, max(1.0, (clock() - began_s) / (STEPS * STEP_S)))


def scheduled(number: int) -> list[str]:
    """The words before PX4's own: one processor, which a fleet's drones take in turn, and SCHED_BATCH (sched(7)).

    Under it a woken thread waits for the running one. PX4 cancels and sets its timer in two steps; its timer thread,
    woken between them, would find no timer and sleep on, and the simulation's sensors would stand still.
    """
    processors = sorted(os.sched_getaffinity(0))
    return ["taskset", "--cpu-list", str(processors[number % len(processors)]), "chrt", "--batch", "0"]


def link_programs(programs: Path, folder: Path) -> None:
    """Link PX4's program by the name of each of its commands: a copied folder may have lost such links."""
    for name in ("px4", "px4-alias.sh"):
        (folder / name).symlink_to(programs / name)
    for name in set(_COMMAND.findall((folder / "px4-alias.sh").read_text(encoding="utf-8"))):
        (folder / f"px4-{name}").symlink_to("px4")


class Px4(Autopilot):
    """One PX4; its folder has bin/px4 and etc."""

    def prepare(self) -> tuple[list[str], dict[str, str]]:
        try:
            values = self._values()
            self._make_folders("log", self._bin, self._hooks)
            link_programs(self.folder.absolute() / "bin", self._bin)
            self._write_hook("px4-rc.params", [f"param set {name} {value}" for name, value in values.items()])
            self._write_hook("px4-rc.mavlink", self._links())
        except OSError as error:
            raise SitlError(f"{error.filename}: {error.strerror}; expected PX4's folder with bin and etc") from error
        environment = {
            **os.environ,
            "PATH": f"{self._hooks}:{os.environ.get('PATH', os.defpath)}",
            "PX4_SIM_MODEL": MODEL,
            "PX4_SIM_SPEED_FACTOR": f"{speed_factor():.3f}",
            **{f"PX4_PARAM_{name}": value for name, value in values.items()},
        }
        words = [str(self._bin / "px4"), "-d", "-i", self._instance, "-w", str(self.work), str(self.folder / "etc")]
        return [*scheduled(self.config.system_id), *words], environment

    def questions(self) -> dict[str, list[str]]:
        command = [str(self._bin / "px4-param"), "--instance", self._instance, "show", "-q"]
        return {name: [*command, name] for name in self._values()}

    def check(self, answers: Mapping[str, str]) -> None:
        """Raises SitlError naming the first parameter whose value is not the one that was set."""
        for name, value in self._values().items():
            try:
                is_so = abs(float(answers[name]) - float(value)) <= _CLOSE * max(1.0, abs(float(value)) / 1e3)
            except ValueError:
                is_so = False
            if not is_so:
                raise SitlError(f"PX4's {name} is {answers[name] or 'not told'}; expected {value}")

    @property
    def _instance(self) -> str:
        return str(self.config.system_id)

    @property
    def _bin(self) -> Path:
        return self.work / "bin"

    @property
    def _hooks(self) -> Path:
        return self.work / "hooks"

    def _values(self) -> dict[str, str]:
        """Every parameter in PX4's own form: an integer, or in 1e-7 degrees, where PX4 defines it so."""
        known = self._known()
        home = self.config.home
        place = {"SIH_LOC_LAT0": home.latitude_deg, "SIH_LOC_LON0": home.longitude_deg, "SIH_LOC_H0": home.altitude_m}
        wanted = {**OWN, **self.config.parameters, **place, "MAV_SYS_ID": self.config.system_id}
        values = {}
        for name, value in wanted.items():
            if name not in known:
                raise SitlError(f"{self.folder / PARAMETERS}: no {name}; expected a PX4 that has it")
            is_whole, units = known[name]["type"].startswith("Int"), known[name].get("units")
            value = value * 1e7 if units == "deg*1e7" else value
            values[name] = str(round(value)) if is_whole else f"{value:.7f}"
        return values

    def _known(self) -> dict[str, dict[str, Any]]:
        path = self.folder / PARAMETERS
        try:
            return {entry["name"]: entry for entry in json.loads(lzma.decompress(path.read_bytes()))["parameters"]}
        except (ValueError, KeyError, TypeError, lzma.LZMAError) as error:
            raise SitlError(f"{path}: expected what PX4's build says of its parameters: {error}") from error

    def _write_hook(self, name: str, lines: list[str]) -> None:
        (self._hooks / name).write_text("\n".join(lines) + "\n", encoding="utf-8")

    def _links(self) -> list[str]:
        """The commands for PX4's link to a companion computer and the witness's; none for a simulation's others."""
        (_, port), (host, to_port) = self.onboard.listen, self.onboard.send
        mode, streams = STREAMS[self.onboard.streams]
        own_port = 18570 + self.config.system_id
        return [
            f"mavlink start -x -u {port} -r {RATE_B_S} -f -m {mode} -o {to_port} -t {host}",
            *(f"mavlink stream -u {port} -s {name} -r {rate_hz}" for name, rate_hz in streams.items()),
            f"mavlink start -x -u {own_port} -r {RATE_B_S} -m custom -o {self.witness}",
            f"mavlink stream -u {own_port} -s HEARTBEAT -r {WITNESS_HEARTBEAT_HZ}",
        ]
