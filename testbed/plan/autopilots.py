"""Real autopilots in place of the stand-ins: the kinds, where each is found, and whether it can run here."""

from __future__ import annotations

import os
import platform
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError

DIR, IMAGE = "AUTOPILOT_DIR", "AUTOPILOT_IMAGE"
"""The settings for compose files and containers: a folder on this machine, or the image with the autopilot."""
_MACHINES = {"x86_64": 62, "aarch64": 183}
"""ELF's e_machine (System V ABI) by the kernel's name of the machine."""
_ELF = struct.Struct("<4s14xH")


@dataclass(frozen=True)
class AutopilotKind:
    """A kind of autopilot: in the folder that `folder_variable` names, or in `folder_in_image` of an image.

    `image_variable` names the image; `image` is its default, None if there is none. `program` and `files` are the paths
    that the folder must have.
    """

    folder_variable: str
    image_variable: str
    image: str | None
    folder_in_image: str
    program: str
    files: tuple[str, ...]

    def settings(self, environment: Mapping[str, str]) -> dict[str, str]:
        """The setting DIR or IMAGE for this environment. Raises UserError for a folder that is not of this kind, or if
        neither folder nor image is known."""
        named = environment.get(self.folder_variable)
        if not named:
            image = environment.get(self.image_variable) or self.image
            if image is None:
                needed = f"a folder with {', '.join((self.program, *self.files))}"
                raise UserError(f"{self.folder_variable}: not set; expected {needed} (or {self.image_variable})")
            return {IMAGE: image}
        folder = Path(named).expanduser().absolute()
        self.check(folder, f"{self.folder_variable}={named}")
        return {DIR: str(folder)}

    def check(self, folder: Path, said: str) -> None:
        """Raise UserError, beginning with `said`, for a folder whose program cannot run here."""
        if not folder.is_dir():
            raise UserError(f"{said}: expected a folder, with {self.program} in it")
        for name in (self.program, *self.files):
            if not (folder / name).is_file():
                raise UserError(f"{said}: no {name}; expected {self.program} and what belongs to it")
        program = folder / self.program
        if not os.access(program, os.X_OK):
            raise UserError(f"{said}: {self.program} is not executable; type: chmod +x {program}")
        _check_machine(program, f"{said}: {self.program}")


def _check_machine(program: Path, said: str) -> None:
    """Raise UserError if the program is built for another kind of machine."""
    with program.open("rb") as file:
        head = file.read(_ELF.size)
    magic, machine = _ELF.unpack(head) if len(head) == _ELF.size else (b"", 0)
    here = platform.machine()
    if magic != b"\x7fELF" or machine != _MACHINES.get(here, machine):
        built = next((name for name, number in _MACHINES.items() if number == machine), "something else")
        raise UserError(f"{said} is built for {built}; expected a Linux program for {here}")


KINDS = {
    "px4": AutopilotKind(
        folder_variable="PX4_DIR",
        image_variable="PX4_IMAGE",
        image="px4io/px4-sitl:v1.17.0",
        folder_in_image="/opt/px4",
        program="bin/px4",
        files=("bin/px4-alias.sh", "etc/init.d-posix/rcS", "etc/extras/parameters.json.xz"),
    ),
    "ardupilot": AutopilotKind(
        folder_variable="ARDUPILOT_DIR",
        image_variable="ARDUPILOT_IMAGE",
        image=None,
        folder_in_image="/opt/ardupilot",
        program="arducopter",
        files=("copter.parm",),
    ),
}
