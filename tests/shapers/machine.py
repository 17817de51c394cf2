"""Boots the virtual machine that `make tools` made, with a job, and returns what the job wrote.

The machine does not use the host's clock: QEMU's -icount counts one nanosecond per instruction, and while the machine
waits for a timer, its time jumps ahead to it. So a busy host slows nothing down in it, and a minute of waiting takes no
time. Two runs still differ by up to a millisecond in when a datagram is sent.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.tools.cpio import Archive
from tests.tools.machine import INITRAMFS, KERNEL, QEMU

ROOT = Path(__file__).resolve().parents[2]
GUEST = Path(__file__).with_name("guest.py")
NET = ROOT / "services/net/src/net"
MEMORY_MIB = 640
TIMEOUT_S = 800.0


class MachineError(Exception):
    """The machine did not do its job; the text has the end of its console."""


class Machine:
    """`start` returns at once, `result` waits."""

    def __init__(self, folder: Path, job: Mapping[str, Any]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._result, self._console = folder / "result.json", folder / "console.txt"
        self._console_file = self._console.open("wb")
        initramfs = folder / "initramfs.cpio"
        shutil.copyfile(INITRAMFS, initramfs)
        with initramfs.open("ab") as out:
            archive = Archive(out)
            archive.file("init", GUEST.read_bytes(), True)
            archive.folder("job")
            for path in [NET, *sorted(NET.rglob("*"))]:
                if path.is_dir() and path.name != "__pycache__":
                    archive.folder(f"job/{path.relative_to(NET.parent)}")
                elif path.suffix == ".py":
                    archive.file(f"job/{path.relative_to(NET.parent)}", path.read_bytes(), False)
            archive.file("job/job.json", json.dumps(job).encode(), False)
            archive.end()
        self._process = subprocess.Popen(
            [
                *(QEMU, "-nodefaults", "-no-user-config", "-display", "none", "-no-reboot"),
                *("-accel", "tcg", "-icount", "shift=0,sleep=off", "-rtc", "base=2020-01-01,clock=vm"),
                *("-machine", "q35", "-cpu", "qemu64", "-smp", "1", "-m", str(MEMORY_MIB)),
                *("-serial", "stdio", "-device", "virtio-serial", "-chardev", f"file,id=out,path={self._result}"),
                *("-device", "virtserialport,chardev=out", "-kernel", str(KERNEL), "-initrd", str(initramfs)),
                *(
                    "-append",
                    "console=ttyS0 quiet panic=-1 tsc=reliable ipv6.disable_ipv6=1 mitigations=off PYTHONHASHSEED=0",
                ),
            ],
            stdin=subprocess.DEVNULL,
            stdout=self._console_file,
            stderr=subprocess.STDOUT,
        )

    def result(self, timeout_s: float = TIMEOUT_S) -> dict[str, Any]:
        """Wait for the result of the job. Raises MachineError."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise MachineError(f"no end within {timeout_s:.0f} s\n{self._tail()}") from None
        finally:
            self.end()
        try:
            found: dict[str, Any] = json.loads(self._result.read_text())
        except (OSError, ValueError) as error:
            raise MachineError(f"{error}\n{self._tail()}") from error
        return found

    def end(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._console_file.close()

    def _tail(self) -> str:
        return self._console.read_text(errors="replace")[-4000:]
