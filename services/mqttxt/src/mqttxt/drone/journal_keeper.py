"""Keeps the journal: the event loop never waits for the disk, nor does a command whose record is in the front."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from ..core.ledger import OVERRIDING
from ..protocol.messages import CommandId
from .effects import Journal
from .journal import JournalFile
from .journal_lines import line_of

_OVERRIDING = frozenset(command.name for command in OVERRIDING)


class JournalKeeper:
    """Passes records to `file` in their order, on a thread of its own.

    `on_disk` is called once for each opening that the front did not take, with whether the disk took it. `on_error` is
    called for each record that the disk did not take. While the disk fails, only hold, land and return are opened with
    the front alone.
    """

    def __init__(
        self,
        file: JournalFile,
        on_disk: Callable[[CommandId, bool], None],
        on_error: Callable[[OSError], None],
    ) -> None:
        self._file = file
        self._on_disk = on_disk
        self._on_error = on_error
        self._thread = ThreadPoolExecutor(1, "journal")
        self._handed_over: deque[tuple[Journal, bool]] = deque()
        self._waiting = 0
        self._is_failing = False
        self._has_ended = False

    def record(self, effect: Journal) -> bool:
        """Keep one record; returns whether it is an opening that the front has. Call it on the event loop.

        The thread is woken at the end of this turn of the loop, after its writes to the autopilot, with which it would
        compete.
        """
        is_begun = self._front_takes(effect) and effect.is_opening
        self._waiting += 1
        self._handed_over.append((effect, is_begun))
        asyncio.get_running_loop().call_soon(self._hand_over)
        return is_begun

    def _hand_over(self) -> None:
        while self._handed_over:
            effect, is_begun = self._handed_over.popleft()
            on_disk = asyncio.get_running_loop().run_in_executor(self._thread, self._file.record, effect, is_begun)
            on_disk.add_done_callback(partial(self._tried, effect, is_begun))

    async def close(self) -> None:
        """Wait until every record was tried on the disk, and close the journal. No command is opened any more."""
        self._has_ended = True
        self._hand_over()
        await asyncio.to_thread(self._thread.shutdown)
        await asyncio.to_thread(self._file.close)

    def _front_takes(self, effect: Journal) -> bool:
        front = self._file.front
        if front is None or (effect.is_opening and self._is_failing and effect.command not in _OVERRIDING):
            return False
        with contextlib.suppress(OSError):  # the front has no room: the disk has to take the record
            front.append(line_of(effect))
            return True
        return False

    def _tried(self, effect: Journal, is_begun: bool, done: asyncio.Future[None]) -> None:
        """The disk took a record, or did not."""
        self._waiting -= 1
        try:
            done.result()
        except OSError as error:
            self._is_failing = True
            self._on_error(error)
        else:
            self._is_failing = False
            if self._file.front is not None and not self._waiting:
                self._file.front.clear()
        if effect.is_opening and not is_begun and not self._has_ended:
            self._on_disk(effect.id, not self._is_failing)
