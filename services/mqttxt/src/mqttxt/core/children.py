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
"""For `preexec_fn`: SIGTERM when the parent ends, however it does (prctl(2)). None where the system has no such thing.

Otherwise a killed role's broker would live on and hold the port.
"""


@contextlib.asynccontextmanager
async def ending_with_parent(child: int) -> AsyncIterator[None]:
    """Within this a child is ended with this process where ENDS_WITH_PARENT does not do it.

    A child of root's that becomes another user rids itself of that, and only Linux has it. There a shell waits for the
    end of a pipe that this process holds.
    """
    if sys.platform == "win32" or (sys.platform == "linux" and os.geteuid() != 0):
        yield
        return
    watching = ("sh", "-c", 'read _; kill "$1"', "sh", str(child))
    # In a session of its own: Ctrl-C in a terminal goes to this process and to what it started.
    guard = await asyncio.create_subprocess_exec(*watching, stdin=asyncio.subprocess.PIPE, start_new_session=True)
    try:
        yield
    finally:
        guard.kill()
        await guard.wait()
