"""What a role tells systemd, where that runs it (Type=notify, WatchdogSec): that it runs, and whether it is ready."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping
from typing import Self

SOCKET = "NOTIFY_SOCKET"


class Service:
    """One service manager's socket, a datagram per call. What it does not take is lost: that ends no role.

    Being ready is its status alone. A drone out of coverage runs, and a boot does not wait for it.
    """

    def __init__(self, address: str) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    @classmethod
    def of(cls, environment: Mapping[str, str] = os.environ) -> Self | None:
        """The one that started this process; None where there is none."""
        address = environment.get(SOCKET)
        return cls(address) if address else None

    def alive(self, is_ready: bool) -> None:
        """The event loop goes round; a role that no longer says so is ended and started again."""
        self._say("READY=1", "WATCHDOG=1", f"STATUS={'ready' if is_ready else 'not ready'}")

    def ending(self) -> None:
        self._say("STOPPING=1", "STATUS=taking leave")

    def _say(self, *lines: str) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto("\n".join(lines).encode(), self._address)
