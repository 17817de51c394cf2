"""The folder of logs in its own thread: a disk may take a second, and the aircraft does not wait for that."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, get_args

from ..log_work import LoadLog, LogDone, LogWork
from .files import LogFiles

MOST_LOADS = 64
"""Requests for bytes that may wait, so that a disk that stalls lets none fill the memory. A station has few under way,
and asks again for those that were dropped.
"""


class LogPort:
    """Carries out requests to the folder in their order; `on_done` gets the results."""

    def __init__(self, files: LogFiles, on_done: Callable[[LogDone], None]) -> None:
        self._files = files
        self._on_done = on_done
        self._asked: asyncio.Queue[LogWork] = asyncio.Queue()
        self.does: dict[type[Any], Callable[[Any], object]] = dict.fromkeys(get_args(LogWork), self._ask)
        """The function that carries out each kind of effect on the folder."""

    def _ask(self, work: LogWork) -> None:
        if not isinstance(work, LoadLog) or self._asked.qsize() < MOST_LOADS:
            self._asked.put_nowait(work)

    async def run(self) -> None:
        """Run until cancelled."""
        loop = asyncio.get_running_loop()
        with ThreadPoolExecutor(1, "logs") as thread:
            while True:
                done = await loop.run_in_executor(thread, self._files.carry_out, await self._asked.get())
                if done is not None:
                    self._on_done(done)
