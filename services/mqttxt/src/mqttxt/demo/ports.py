"""Ports of loopback for the demo's parts."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator

HOST = "127.0.0.1"
_CHOICE = range(15_000, 18_000)
"""Not those that a system gives to clients: a connection could take one before its owner listens there."""


def free_ports(*preferred: int) -> Iterator[int]:
    """Ports that nobody uses when they are asked for, TCP or UDP: first the preferred, then others, each once."""
    return (port for port in (*preferred, *random.sample(_CHOICE, len(_CHOICE))) if is_free(port))


def is_free(port: int) -> bool:
    """Whether one could listen there now, TCP and UDP."""
    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
        with socket.socket(socket.AF_INET, kind) as sock:
            try:
                sock.bind((HOST, port))
            except OSError:
                return False
    return True
