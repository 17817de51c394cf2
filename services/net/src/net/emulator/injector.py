"""Sends a duplicated packet's copy, since a verdict releases only one packet.

It uses a raw socket bound to the link's interface, addressed to the node at its other end whatever the packet's
destination is. So the copy bypasses routing and the rules for forwarded packets, and its IP header is unchanged.
"""

from __future__ import annotations

import errno
import socket

from ..interfaces import NetError

SO_BINDTODEVICE = 25


class Injector:
    """A raw socket on an interface. Raises NetError if it cannot be opened."""

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
        """Send a whole IPv4 packet; returns False if the kernel refuses it. Raises NetError if it refuses any packet.

        It refuses a header that a flipped bit made invalid, and packets that wait for an address that no node has.
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
