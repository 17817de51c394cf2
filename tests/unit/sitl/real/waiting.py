"""What tests of processes need: a port of their own, and to wait for a condition."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


async def until(condition: Callable[[], bool], act: Callable[[], object] = lambda: None) -> None:
    """Wait for a condition; `act` is done before each look."""
    async with asyncio.timeout(10):
        while not condition():
            act()
            await asyncio.sleep(0.02)
