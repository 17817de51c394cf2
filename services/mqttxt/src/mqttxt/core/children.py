"""Processes that end with the process that started them."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable

_PR_SET_PDEATHSIG = 1


def _ends_with_parent() -> Callable[[], None] | None:
    if sys.platform != "linux":
        return None
    libc = ctypes.CDLL(None)

    def in_child() -> None:
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)

    return in_child


ENDS_WITH_PARENT = _ends_with_parent()
"""For `preexec_fn`: SIGTERM to the child when its parent ends, in whatever way (prctl(2)). None except on Linux.

Otherwise a killed role's broker would live on and keep the port.
"""


@contextlib.asynccontextmanager
async def ending_with_parent(child: int) -> AsyncIterator[None]:
    """End the process `child` with this one where ENDS_WITH_PARENT does not: outside Linux, and for root.

    A child of root that changes its user loses the parent-death signal. There a shell waits for the end of a pipe that
    this process holds, and then ends the child. Not on Windows.
    """
    if sys.platform == "win32" or (sys.platform == "linux" and os.geteuid() != 0):
        yield
        return
    watching = ("sh", "-c", 'read _; kill "$1"', "sh", str(child))
    # In a session of its own, because Ctrl-C in a terminal reaches this process and its children.
    guard = await asyncio.create_subprocess_exec(*watching, stdin=asyncio.subprocess.PIPE, start_new_session=True)
    try:
        yield
    finally:
        guard.kill()
        await guard.wait()
