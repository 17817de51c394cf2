"""Made-up folders of autopilot builds."""

from __future__ import annotations

import platform
import struct
from pathlib import Path

from testbed.plan.autopilots import KINDS, AutopilotKind

PX4 = KINDS["px4"]


def make_folder(folder: Path, kind: AutopilotKind = PX4, machine: str = "") -> Path:
    """Make a folder with an autopilot's files; its program is nothing but an ELF header."""
    numbers = {"x86_64": 62, "aarch64": 183}
    number = numbers[machine or platform.machine()]
    for name in (kind.program, *kind.files):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    (folder / kind.program).write_bytes(struct.pack("<4s14xH", b"\x7fELF", number))
    (folder / kind.program).chmod(0o755)
    return folder
