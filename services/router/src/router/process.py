"""The node as processes: starts every mavp2p, follows what each says, and ends all when one ends."""

from __future__ import annotations

import asyncio
import contextlib
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections.abc import AsyncIterator
from pathlib import Path

from .chains import Router
from .heard import Heard

READY_S = 1.0
STOP_TIMEOUT_S = 2.0


class Node:
    """A node's routers. `ready_file` is touched while each of them hears its autopilots; always where there is none."""

    def __init__(self, program: str, routers: tuple[Router, ...], ready_file: Path) -> None:
        self._program = program
        self._routers = routers
        self._ready_file = ready_file
        self._heard = {router: Heard() for router in routers}

    async def run(self) -> str:
        """Run until cancelled; returns why when a router ended by itself, or could not be started."""
        if not self._routers:
            print("no router in a direct chain", flush=True)
        async with contextlib.AsyncExitStack() as stack:
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
                    await asyncio.wait_for(process.wait(), STOP_TIMEOUT_S)
                except TimeoutError:
                    process.kill()
                    await process.wait()

    async def _follow(self, router: Router, process: Process) -> str:
        """Pass on what a router says, until it ends; returns how it ended."""
        assert process.stdout is not None
        said = ""
        async for line in process.stdout:
            said = line.decode(errors="replace").rstrip()
            if self._heard[router].line(said):
                print(f"{router.name}: {said}", flush=True)
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
