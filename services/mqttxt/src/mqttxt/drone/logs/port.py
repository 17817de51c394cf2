"""The folder of logs in its own thread: a disk may take a second, and the aircraft does not wait for that."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, get_args

from ..log_work import LogDone, LogWork
from .files import LogFiles


class LogPort:
    """Carries out requests to the folder in their order; `on_done` gets the results."""

    def __init__(self, files: LogFiles, on_done: Callable[[LogDone], None]) -> None:
        self._files = files
        self._on_done = on_done
        self._asked: asyncio.Queue[LogWork] = asyncio.Queue()
        self.does: dict[type[Any], Callable[[Any], object]] = dict.fromkeys(get_args(LogWork), self._asked.put_nowait)
        """The function that carries out each kind of effect on the folder."""

    async def run(self) -> None:
        """Run until cancelled."""
        loop = asyncio.get_running_loop()
        with ThreadPoolExecutor(1, "logs") as thread:
            while True:
                done = await loop.run_in_executor(thread, self._files.carry_out, await self._asked.get())
                if done is not None:
                    self._on_done(done)
