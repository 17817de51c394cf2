"""MAVProxy as a process into which a test types."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.rigs.processes import PATIENCE_S, ROOT, wait_until

REQUIREMENTS = ROOT / "requirements" / "mavproxy.txt"
SEEN = re.compile(r"Detected vehicle (\d+):1 on link 0")


def wheel() -> Path:
    """MAVProxy's wheel, which runs without installation; downloaded once, in the pinned version."""
    folder = ROOT / ".cache" / "mavproxy"
    version = re.search(r"mavproxy==(\S+)", REQUIREMENTS.read_text())
    assert version is not None
    found = folder / f"mavproxy-{version[1]}-py3-none-any.whl"
    if not found.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=folder) as new:  # another worker may be downloading it, too
            options = ["--quiet", "--require-hashes", "--no-deps", "--only-binary", ":all:", "--dest", new]
            pip = [sys.executable, "-m", "pip", "download", *options, "--requirement", str(REQUIREMENTS)]
            subprocess.run(pip, check=True)
            (Path(new) / found.name).replace(found)
    return found


class MavProxy:
    """A MAVProxy; its output is kept, and lines can be typed into it."""

    def __init__(self, folder: Path, master: str) -> None:
        options = ["--master", master, "--nowait", "--state-basedir", str(folder)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "MAVProxy.mavproxy", *options],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(wheel()), "PYTHONUNBUFFERED": "1", "HOME": str(folder)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.said = ""
        self._log = folder / "mavproxy.log"
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def type_until_said(self, line: str, answer: str) -> None:
        """Type a line until it is answered: MAVProxy sends a command once, and a busy router drops messages."""
        typed_s = -math.inf

        def answered() -> bool:
            nonlocal typed_s
            if answer not in self.said and time.monotonic() > typed_s + PATIENCE_S / 10:
                self.type(line)
                typed_s = time.monotonic()
            return answer in self.said

        wait_until(answered, f"{line!r} is answered: {answer}")

    def type(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()

    def choose(self, vehicle: int, of: set[int]) -> None:
        """Wait until it sees these vehicles, and choose one of them."""
        wait_until(lambda: {int(found) for found in SEEN.findall(self.said)} == of, f"vehicles {of}")
        # Its autopilot: without the component, that would stay that of whoever was heard first.
        self.type(f"vehicle {vehicle}:1")
        wait_until(lambda: f"Set vehicle {vehicle}:1" in self.said, f"vehicle {vehicle} is chosen")

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._log.open("w", buffering=1) as log:
            for line in self._process.stdout:
                self.said += line
                log.write(line)
