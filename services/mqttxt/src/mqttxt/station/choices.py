"""A station's open choices across fogs: each runs to its end, awaited or not."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from ..errors import StationEnded
from .heard import Record, SentCommand
from .outcomes import Outcome, PsmiList, last_word


class Choices:
    """The open choices of one station."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(self, choice: AsyncIterator[Outcome | PsmiList]) -> SentCommand[Outcome, Outcome | PsmiList]:
        """Run a choice in a task of its own; returns the command that follows it."""
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
        """Cancel the choices, which then release their reservations."""
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)
