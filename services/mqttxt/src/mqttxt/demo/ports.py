"""Ports of loopback for the demo's parts."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator

HOST = "127.0.0.1"
_CHOICE = range(15_000, 18_000)
"""Outside of the ports that systems give to clients: a connection could take one before its owner listens."""


def free_ports(*preferred: int) -> Iterator[int]:
    """Ports that are free for TCP and UDP when they are yielded: first the preferred, then others, each once."""
    return (port for port in (*preferred, *random.sample(_CHOICE, len(_CHOICE))) if is_free(port))


def is_free(port: int) -> bool:
    """Whether the port is free now, for TCP and UDP."""
    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
        with socket.socket(socket.AF_INET, kind) as sock:
            try:
                sock.bind((HOST, port))
            except OSError:
                return False
    return True
