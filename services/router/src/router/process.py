"""Runs a node's mavp2p processes: starts them in the node's turn, follows their output, ends all when one ends."""

from __future__ import annotations

import asyncio
import contextlib
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from .chains import Router
from .heard import Heard

READY_S = 1.0
LOOK_S = 0.05
STOP_TIMEOUT_S = 2.0


@dataclass(frozen=True)
class Turn:
    """Orders the start of nodes: routers start once the file `after` exists; `listening` exists while all listen.

    A mavp2p that sends to a neighbour before that one listens is refused, and replaces its socket. Over a link with a
    delay the neighbour may have begun to listen meanwhile: it then knows both sockets, and for a minute sends every
    other message to the closed one.
    """

    after: Path | None
    listening: Path | None

    async def wait(self) -> None:
        """Wait until the file `after` exists."""
        if self.after is not None and not self.after.exists():
            print(f"waiting for {self.after}, where the next node's routers say that they listen", flush=True)
            while not self.after.exists():
                await asyncio.sleep(LOOK_S)

    def tell(self) -> str | None:
        """Create the file `listening`; returns the error if that fails."""
        try:
            if self.listening is not None:
                self.listening.touch()
        except OSError as error:
            return f"--listening {self.listening}: {error.strerror}"
        return None

    def take_back(self) -> None:
        if self.listening is not None:
            self.listening.unlink(missing_ok=True)


class Node:
    """A node's routers. `ready_file` is touched while each of them hears its autopilots; always if there is none."""

    def __init__(self, program: str, routers: tuple[Router, ...], ready_file: Path, turn: Turn) -> None:
        self._program = program
        self._routers = routers
        self._ready_file = ready_file
        self._turn = turn
        self._heard = {router: Heard() for router in routers}

    async def run(self) -> str:
        """Run until cancelled; returns the reason if a router ends or cannot start, or a file cannot be written."""
        await self._turn.wait()
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(self._turn.take_back)
            if not self._routers:
                print("no router in a direct chain", flush=True)
                if failure := self._turn.tell():
                    return failure
            try:
                started = [await stack.enter_async_context(self._started(router)) for router in self._routers]
            except OSError as error:
                return f"{self._program}: {error.strerror}"
            tasks = [
                asyncio.create_task(self._follow(router, process))
                for router, process in zip(self._routers, started, strict=True)
            ]
            tasks.append(asyncio.create_task(self._show_ready()))
            for task in tasks:
                stack.callback(task.cancel)
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            return done.pop().result()

    @contextlib.asynccontextmanager
    async def _started(self, router: Router) -> AsyncIterator[Process]:
        process = await asyncio.create_subprocess_exec(
            self._program, *router.arguments, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT
        )
        try:
            yield process
        finally:
            if process.returncode is None:
                process.terminate()
                try:
                    async with asyncio.timeout(STOP_TIMEOUT_S):
                        await process.wait()
                except TimeoutError:
                    process.kill()
                    await process.wait()

    async def _follow(self, router: Router, process: Process) -> str:
        """Print a router's output until it ends; returns the reason for the end."""
        assert process.stdout is not None
        said = ""
        async for line in process.stdout:
            said = line.decode(errors="replace").rstrip()
            if self._heard[router].line(said):
                print(f"{router.name}: {said}", flush=True)
            if all(heard.listening for heard in self._heard.values()) and (failure := self._turn.tell()):
                return failure
        code = await process.wait()
        return f"mavp2p {' '.join(router.arguments)} ended with code {code}; its last words: {said or 'none'}"

    async def _show_ready(self) -> str:
        while True:
            if all(self._heard[router].has(router.drones) for router in self._routers):
                try:
                    self._ready_file.touch()
                except OSError as error:
                    return f"--ready-file {self._ready_file}: {error.strerror}"
            await asyncio.sleep(READY_S)
