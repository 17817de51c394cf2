"""Notifications of a role to systemd (Type=notify, WatchdogSec): that it runs, and whether it is ready."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping
from typing import Self

SOCKET = "NOTIFY_SOCKET"


class Service:
    """The service manager's socket; each call sends one datagram. One that cannot be sent is lost, and ends no role.

    Readiness only shows in STATUS; READY=1 is sent in any case. So a boot does not wait for a drone out of coverage.
    """

    def __init__(self, address: str) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    @classmethod
    def of(cls, environment: Mapping[str, str] = os.environ) -> Self | None:
        """The service manager that started this process; None if none did."""
        address = environment.get(SOCKET)
        return cls(address) if address else None

    def alive(self, is_ready: bool) -> None:
        """Report that the event loop runs; systemd restarts a role that no longer does."""
        self._say("READY=1", "WATCHDOG=1", f"STATUS={'ready' if is_ready else 'not ready'}")

    def ending(self) -> None:
        self._say("STOPPING=1", "STATUS=shutting down")

    def _say(self, *lines: str) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto("\n".join(lines).encode(), self._address)
