"""Ports of loopback, and waits for conditions, for tests that run on every system."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import socket
import time
from collections.abc import Callable

PATIENCE_S = 60.0
_WORKER, _WORKERS = (
    int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]),
    int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1)),
)
_PORTS = range(20_000 + _WORKER % _WORKERS, 32_000, _WORKERS)
"""The ports of this worker, if several run the tests."""
_BLOCKS, _BLOCK = range(16_000 + 10 * (_WORKER % _WORKERS), 20_000, 10 * _WORKERS), 10
"""The first port of each block of this worker, and how many a block has."""
_RANDOM = random.SystemRandom()
_given: set[int] = set()


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port of loopback that is unused now and was not returned before, by other workers neither.

    It is not one of the ephemeral ports: a client's connection could take one of those before its owner binds it, or
    while the owner restarts.
    """
    while True:
        port = _RANDOM.choice(_PORTS)
        if port in _given:
            continue
        with socket.socket(socket.AF_INET, kind) as sock, contextlib.suppress(OSError):
            sock.bind(("127.0.0.1", port))
            _given.add(port)
            return port


def free_block(count: int) -> int:
    """The first of `count` ports, at most ten, one after the other, as `free_port` gives one."""
    assert count <= _BLOCK
    while True:
        first = _RANDOM.choice(_BLOCKS)
        if first in _given:
            continue
        with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
            for port in range(first, first + count):
                stack.enter_context(socket.socket()).bind(("127.0.0.1", port))
            _given.add(first)
            return first


def listens(port: int, host: str = "127.0.0.1") -> bool:
    """Whether a TCP connection to a port is accepted."""
    with socket.socket() as sock:
        return sock.connect_ex((host, port)) == 0


def wait_until(condition: Callable[[], object], what: str, limit_s: float = PATIENCE_S) -> None:
    """Wait until a condition holds; fails the test with `what` after `limit_s`."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, f"not within {limit_s:g} s: {what}"
        time.sleep(0.02)


async def eventually(condition: Callable[[], object], what: str, limit_s: float = PATIENCE_S) -> None:
    """`wait_until` for a test whose event loop has to keep running."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, f"not within {limit_s:g} s: {what}"
        await asyncio.sleep(0.02)
