"""Non-blocking UDP sockets, and the time at which the kernel received each datagram."""

from __future__ import annotations

import socket
import struct
import sys
import time

from .errors import SitlError

_SO_TIMESTAMPNS = 35
"""socket(7), asm-generic/socket.h: a control message with a timespec, for each datagram."""
_TIMESPEC = struct.Struct("@ll")
ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)
LARGEST_DATAGRAM = 65_536


def bind(address: tuple[str, int]) -> socket.socket:
    """Return a socket that receives on `address`. Raises SitlError if it cannot be bound."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind(address)
    except OSError as error:
        sock.close()
        raise SitlError(f"cannot receive on {address[0]}:{address[1]}: {error.strerror}") from error
    sock.setblocking(False)
    if sys.platform == "linux":
        sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return sock


def arrival_ns(ancillary: list[tuple[int, int, bytes]]) -> int:
    """When the kernel received a datagram, in nanoseconds since 1970; the present time if it does not say."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
            seconds, nanoseconds = _TIMESPEC.unpack(data)
            return int(seconds * 1_000_000_000 + nanoseconds)
    return time.time_ns()
