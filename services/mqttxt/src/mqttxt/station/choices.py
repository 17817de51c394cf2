"""The choices across fogs that a station has begun: each is carried through, whether or not somebody waits for it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from ..errors import StationEnded
from .heard import Record, SentCommand
from .outcomes import Outcome, PsmiList, last_word


class Choices:
    """Those of one station that are under way."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(self, choice: AsyncIterator[Outcome | PsmiList]) -> SentCommand[Outcome, Outcome | PsmiList]:
        """Carry a choice through, and follow it."""
        record = Record[Outcome | PsmiList]()

        async def carry_through() -> None:
            async for said in choice:
                record.hear(said)

        def end(task: asyncio.Task[None]) -> None:
            self._tasks.discard(task)
            record.end(StationEnded("the ground station has ended") if task.cancelled() else task.exception())

        task = asyncio.create_task(carry_through())
        self._tasks.add(task)
        task.add_done_callback(end)
        return SentCommand(record, last_word)

    async def end(self) -> None:
        """End them; what they have reserved is released."""
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)
