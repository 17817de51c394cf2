"""Sends a duplicated packet's copy: a verdict lets one packet go, not two.

A raw socket bound to the link's interface, towards the node at its other end whatever the packet's destination is; so
the copy passes no routing and no rule for forwarded packets, and its IP header goes out as it came.
"""

from __future__ import annotations

import errno
import socket

from ..interfaces import NetError

SO_BINDTODEVICE = 25


class Injector:
    """Raises NetError where the socket cannot be had."""

    def __init__(self, interface: str, neighbour: str) -> None:
        self._to = (neighbour, 0)
        try:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.IPPROTO_RAW)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_BINDTODEVICE, interface.encode() + b"\0")
        except OSError as error:
            raise NetError(
                f"a raw socket on {interface}: {error.strerror}; expected CAP_NET_RAW, which duplication needs"
            ) from error

    def send(self, packet: bytes) -> bool:
        """A whole IPv4 packet; False where the kernel does not take it. Raises NetError where it takes none.

        It refuses a header that a turned bit made senseless, and what waits for an address that nobody has.
        """
        try:
            self._socket.sendto(packet, socket.MSG_DONTWAIT, self._to)
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.EMSGSIZE):
                return False
            raise NetError(f"a copy to {self._to[0]}: {error.strerror}; expected its link to be up") from error
        return True
