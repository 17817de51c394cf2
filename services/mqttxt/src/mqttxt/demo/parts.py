"""A part of the demo: a process that is started, watched, and ended with all of its children."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path

from ..core.children import ENDS_WITH_PARENT
from ..errors import PartEnded

END_S = 10.0
"""How long a part may take to end after SIGTERM."""
LAST_WORDS = 5
"""The lines that are shown of a part that has ended."""


def _environment() -> dict[str, str]:
    """This process's environment without options: a part has those of its command line alone."""
    return {name: value for name, value in os.environ.items() if not name.startswith("MQTTXT_")}


class DemoProcess:
    """One process in a process group of its own, so that Ctrl-C reaches the demo alone, which ends its parts in order.

    Parameters:
        name: its name for people.
        command: the program and its arguments.
        hear: called with each line that it writes.
        sign: the end of the line that shows that it runs.
    """

    def __init__(self, name: str, command: Iterable[str], hear: Callable[[str], None], sign: str = "") -> None:
        self.name = name
        self._command = tuple(command)
        self._hear = hear
        self._lines: deque[str] = deque(maxlen=LAST_WORDS)
        self._sign = sign
        self.runs: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
        """True once it has written its sign, False if it has ended without."""
        self._process: Process | None = None
        self._ended: asyncio.Task[int] | None = None

    async def start(self, folder: Path) -> None:
        """Start it; its temporary files are in `folder`."""
        self._process = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=DEVNULL,
            stdout=PIPE,
            stderr=STDOUT,
            cwd=folder,
            env={**_environment(), "TMPDIR": str(folder), "PYTHONUNBUFFERED": "1"},
            process_group=0,
            preexec_fn=ENDS_WITH_PARENT,
        )
        self._ended = asyncio.create_task(self._follow(self._process))

    @property
    def ended(self) -> asyncio.Task[int]:
        """A task that is done when the part has ended; its result is the exit code."""
        assert self._ended is not None
        return self._ended

    def last_words(self) -> PartEnded:
        """The error for a part that has ended unasked."""
        code = self.ended.result()
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        return PartEnded(f"{self.name} {how}; its last words: {' | '.join(self._lines) or 'none'}")

    async def end(self) -> None:
        """End it, by force after `END_S`, and kill the rest of its process group."""
        process = self._process
        if process is None:
            return
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        await asyncio.wait({self.ended}, timeout=END_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        await self.ended

    async def _follow(self, process: Process) -> int:
        assert process.stdout is not None
        async for line in process.stdout:
            self._lines.append(line.decode(errors="replace").rstrip())
            self._hear(self._lines[-1])
            if not self.runs.done() and self._lines[-1].endswith(self._sign):
                self.runs.set_result(True)
        if not self.runs.done():
            self.runs.set_result(False)
        return await process.wait()
