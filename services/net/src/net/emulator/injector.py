"""Sends a duplicated packet's copy: a verdict lets one packet go, not two.

A raw socket bound to the link's interface, towards the node at its other end whatever the packet's destination is; so
the copy passes no routing and no rule for forwarded packets, and its IP header goes out as it came.
"""

from __future__ import annotations

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

    def send(self, packet: bytes) -> None:
        """A whole IPv4 packet."""
        self._socket.sendto(packet, self._to)
