"""What a station's program can wait for: the words about a command that it sent, and the stream of all events."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Generator, Hashable, Sequence
from typing import Generic, TypeVar

from ..protocol.states import AutopilotText
from .outcomes import Event, QodsRanking, StateUpdate

MOST_WAITING = 50_000
"""How many events wait for a slow reader before states that newer ones have replaced are left out."""

Answer = TypeVar("Answer")
Heard = TypeVar("Heard")


class Bell:
    """Wakes all tasks that wait for it, each time that it rings."""

    def __init__(self) -> None:
        self._next: asyncio.Future[None] | None = None

    def ring(self) -> None:
        rung, self._next = self._next, None
        if rung is not None:
            rung.set_result(None)

    async def wait(self) -> None:
        """Return at the next ring; a cancellation ends this wait and no other one."""
        if self._next is None:
            self._next = asyncio.get_running_loop().create_future()
        await asyncio.wait({self._next})


class Record(Generic[Heard]):
    """The words so far, in their order, for any number of waiting tasks."""

    def __init__(self) -> None:
        self.said: deque[Heard] = deque()
        self._bell = Bell()
        self._has_ended = False
        self._error: BaseException | None = None

    def hear(self, said: Heard) -> None:
        self.said.append(said)
        self._bell.ring()

    def end(self, error: BaseException | None = None) -> None:
        """End the record: no more words arrive. `error` is the reason, unless it is a regular end."""
        self._has_ended, self._error = True, error
        self._bell.ring()

    async def more_than(self, count: int) -> bool:
        """Wait for more than `count` words. Returns False at a regular end; raises the error of any other end."""
        while len(self.said) <= count:
            if self._error is not None:
                raise self._error.with_traceback(None)  # which would grow with each wait
            if self._has_ended:
                return False
            await self._bell.wait()
        return True


class Events(Record[Event]):
    """The events that wait for their reader. Where too many do, of each state and ranking only the newest waits."""

    def __init__(self) -> None:
        super().__init__()
        self._most = MOST_WAITING

    def hear(self, said: Event) -> None:
        super().hear(said)
        if len(self.said) > self._most:
            self._thin()

    def _thin(self) -> None:
        """Leave out what a newer event replaces; twice as many as are left may wait until the next time."""
        seen: set[Hashable] = set()
        kept: deque[Event] = deque()
        for event in reversed(self.said):
            replaced_by = _replaced_by(event)
            if replaced_by is None or replaced_by not in seen:
                kept.appendleft(event)
                seen.add(replaced_by)
        self.said, self._most = kept, max(MOST_WAITING, 2 * len(kept))


def _replaced_by(event: Event) -> Hashable:
    """What a newer event has in common with one that it replaces; None where each event counts."""
    if isinstance(event, StateUpdate) and not isinstance(event.state, AutopilotText):
        return event.fleet, event.fog, event.drone, event.state.name
    return (event.fleet, event.fog) if isinstance(event, QodsRanking) else None


class SentCommand(Generic[Answer, Heard]):
    """A command that was sent. Await it for its answer, or iterate over it to follow its words.

    The call that returns this object has sent the command, once. No use of the object sends the command again, takes it
    back or stops it:

    - `await` returns the answer, as the call that sent the command describes it. Every further `await`, in any task,
      returns the same answer.
    - `async for` yields every word about the command, up to its end. Every iteration begins with the first
      word, whenever it is started.
    - Cancelling a wait, as a timeout does, and leaving an iteration, early or by an exception, ends only the waiting.
      The command goes on, and can be awaited again. Send `Hold` to stop a drone.
    - A command that is never awaited is carried out too.
    - `asyncio.ensure_future` makes a task that waits. `asyncio.create_task`, also that of a TaskGroup, raises TypeError
      for anything but a coroutine; the command has been sent by then.

    Both raise StationEnded where the station is left before the command has ended, and BrokerRefused where the broker
    ended the station: whether the command is carried out is then not known.
    """

    def __init__(self, record: Record[Heard], answer: Callable[[Sequence[Heard]], Answer]) -> None:
        self._record = record
        self._answer = answer

    def __repr__(self) -> str:
        """Shown above all by the TypeError of `asyncio.create_task`, which names its argument."""
        return "<SentCommand: the command was sent; asyncio.ensure_future makes a task that waits for it>"

    def __await__(self) -> Generator[None, None, Answer]:
        return self._wait().__await__()

    async def __aiter__(self) -> AsyncIterator[Heard]:
        told = 0
        while await self._record.more_than(told):
            yield self._record.said[told]
            told += 1

    async def _wait(self) -> Answer:
        while await self._record.more_than(len(self._record.said)):
            pass
        return self._answer(self._record.said)


class EventStream:
    """Every event of a ground station from the call of `GroundStation.events` on, as an asynchronous iterator.

    It ends with the station. Where the broker ended the station, it raises BrokerRefused after the last event. A stream
    that is no longer used need not be closed. One whose reader is slow keeps every event up to 50,000; beyond that, of
    each state of a drone, but its autopilot's texts, and of each fog's ranking the newest alone. It loses no other one.
    """

    def __init__(self, record: Events) -> None:
        self._record = record

    def __aiter__(self) -> EventStream:
        return self

    async def __anext__(self) -> Event:
        if not await self._record.more_than(0):
            raise StopAsyncIteration
        return self._record.said.popleft()
