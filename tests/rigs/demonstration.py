"""`mqttxt demo` as a person runs it: in a terminal, on a machine on which the test sees every process and file."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.rigs.processes import ROOT, wait_until
from tests.tools.node_programs import MOSQUITTO

READY = "Ctrl-C here ends everything"
START_S = 150.0
"""Longer than the demo waits for its drones."""


class Desk:
    """A folder that is a person's home, with an `environment` in which the programs of `bin` and their files in `tmp`
    are its own: Mosquitto, Python and `mqttxt`, that of the repository.
    """

    def __init__(self, folder: Path) -> None:
        self.temporary, self.tools = folder / "tmp", folder / "bin"
        for made in (self.temporary, self.tools):
            made.mkdir()
        (self.tools / "mosquitto").symlink_to(MOSQUITTO)
        for name, words in {"mqttxt": " -m mqttxt", "python": ""}.items():
            (self.tools / name).write_text(f'#!/bin/sh\nexec "{sys.executable}"{words} "$@"\n')
            (self.tools / name).chmod(0o755)
        home = {"HOME": str(folder), "TMPDIR": str(self.temporary), "PATH": f"{self.tools}:{os.environ['PATH']}"}
        self.environment = {key: value for key, value in os.environ.items() if not key.startswith("XDG_")} | home


class Demonstration:
    """The demo as a process; `mqttxt` is the command, by default that of the repository."""

    def __init__(self, folder: Path, mqttxt: Path | None = None) -> None:
        self.log = folder / "demo.log"
        desk = Desk(folder)
        self.temporary, self._environment = desk.temporary, desk.environment
        self.mqttxt = mqttxt or desk.tools / "mqttxt"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, *arguments: str, **environment: str) -> None:
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                [self.mqttxt, "demo", *arguments],
                cwd=ROOT,
                env=self._environment | environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def wait_for(self, text: str) -> None:
        """Wait until it has printed `text`; fails if it ends before."""
        wait_until(lambda: text in self.said() or self.exit_code is not None, f"{text!r}: {self.log}", START_S)
        assert text in self.said(), self.said()

    @property
    def exit_code(self) -> int | None:
        assert self._process is not None
        return self._process.poll()

    def page(self) -> str:
        """The page's address, which is printed before the drones are ready."""
        (found,) = re.findall(r"^the page: (\S+)$", self.said(), re.MULTILINE)
        return str(found)

    def printed(self) -> list[str]:
        """The command lines that it tells the user to type, without their comments."""
        return [line.split("   #")[0].strip() for line in re.findall(r"^  (\S.*)$", self.said(), re.MULTILINE)]

    def type(self, lines: Sequence[str]) -> str:
        """Type lines in one terminal and return their output. Each has to succeed."""
        done = subprocess.run(
            ["bash", "-e", "-c", "\n".join(lines)],
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=200,
            check=False,
        )
        assert done.returncode == 0, f"{done.stdout}\n{self.said()}"
        return done.stdout

    def signal(self, number: signal.Signals) -> None:
        """Signal the demo and its process group, as a terminal's Ctrl-C does."""
        assert self._process is not None
        os.killpg(self._process.pid, number)

    def wait(self) -> int:
        assert self._process is not None
        return self._process.wait(60)

    def processes(self) -> dict[int, str]:
        """The command lines of the demo's processes, by id; they are known by its folder for temporary files."""
        mark = f"TMPDIR={self.temporary}".encode()
        found = {}
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                environment, command = (entry / "environ").read_bytes(), (entry / "cmdline").read_bytes()
            except OSError:  # it has ended, or is another person's
                continue
            if mark in environment:
                found[int(entry.name)] = command.replace(b"\0", b" ").decode()
        return found

    def part(self, *words: str) -> int:
        """The id of the process whose command line has these words."""
        (found,) = [pid for pid, command in self.processes().items() if all(f" {word} " in command for word in words)]
        return found

    def nothing_is_left(self) -> bool:
        return not self.processes() and not any(self.temporary.iterdir())

    def close(self) -> None:
        if self._process is not None:
            for pid in self.processes():
                with contextlib.suppress(ProcessLookupError):  # it has ended since
                    os.kill(pid, signal.SIGKILL)
            self._process.wait()
