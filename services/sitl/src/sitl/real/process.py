"""An autopilot as a child process: started, its parameters read back, watched, and ended with its parent."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process

from ..errors import AutopilotDied
from .autopilot import Autopilot
from .watching import Watching

END_S = 2.0
LOOK_S = 0.2


async def fly(autopilot: Autopilot, watching: Watching) -> None:
    """Run it until cancelled. Its output goes to stdout.

    Raises SitlError if it cannot be prepared or has not taken a setting, AutopilotDied if it does not start or ends.
    """
    words, environment = autopilot.prepare()
    try:
        child = await asyncio.create_subprocess_exec(
            *words, cwd=autopilot.work, env=environment, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT
        )
    except OSError as error:
        raise AutopilotDied(f"{words[0]}: {error.strerror}") from error
    checked = asyncio.Event()
    tasks = [
        asyncio.create_task(_say(child, type(autopilot).__name__)),
        asyncio.create_task(watching.run(checked.is_set)),
        asyncio.create_task(_check(autopilot, watching, checked)),
    ]
    try:
        while all(not task.done() or task.exception() is None for task in tasks):
            await asyncio.wait([task for task in tasks if not task.done()], return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            if task.done():
                task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await _end(child)


async def _say(child: Process, name: str) -> None:
    """Pass on its output. Raises AutopilotDied when it ends."""
    assert child.stdout is not None
    async for line in child.stdout:
        sys.stdout.write(line.decode(errors="replace"))
        sys.stdout.flush()
    raise AutopilotDied(f"{name} ended with exit code {await child.wait()}")


async def _check(autopilot: Autopilot, watching: Watching, checked: asyncio.Event) -> None:
    """After its first heartbeat, read back the parameters that were set, and check them."""
    while watching.witness.heard_ns is None:
        await asyncio.sleep(LOOK_S)
    answers = {}
    for name, words in autopilot.questions().items():
        asked = await asyncio.create_subprocess_exec(*words, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT)
        said, _ = await asked.communicate()
        answers[name] = said.decode(errors="replace").strip()
    autopilot.check(answers)
    checked.set()


async def _end(child: Process) -> None:
    """Interrupt it, so that it closes its log; kill it if it does not end."""
    with contextlib.suppress(ProcessLookupError):
        child.send_signal(signal.SIGINT)
    try:
        async with asyncio.timeout(END_S):
            await child.wait()
    except TimeoutError:
        child.kill()
        await child.wait()
