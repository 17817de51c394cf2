"""The channel between `net route` and its emulator: a pair of sockets, a message of JSON each.

Orders: `{"start_ns": …}` (unix time), `{"link", "change": {…} or null}` (by hand), `{"link", "shut": true or false}`.
Each is answered, once it is in force, by `{"done": unix ns, "events": […]}`. Without being asked the emulator says
`{"ready": {…}}` when every link is shaped, and `{"events": […]}` when the profile has changed a link.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from typing import Any

from ..interfaces import NetError

MOST_BYTES = 1 << 17


class Channel:
    """One end. Neither end waits in `receive`, unless it set a timeout on the socket."""

    def __init__(self, end: socket.socket) -> None:
        self.socket = end
        end.setblocking(False)

    @classmethod
    def pair(cls) -> tuple[Channel, Channel]:
        """Two ends that are joined."""
        one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        return cls(one), cls(other)

    @classmethod
    def of_descriptor(cls, descriptor: int) -> Channel:
        """The end that a process was started with."""
        return cls(socket.socket(fileno=descriptor))

    def send(self, content: Mapping[str, Any]) -> None:
        """Raises NetError where the other end is gone or reads nothing any more."""
        try:
            self.socket.send(json.dumps(content).encode())
        except OSError as error:
            raise NetError(f"net route and its emulator: {error.strerror}; expected both to run") from error

    def receive(self) -> dict[str, Any] | None:
        """The next message; empty where the other end is gone, None while there is nothing."""
        try:
            data = self.socket.recv(MOST_BYTES)
        except (BlockingIOError, TimeoutError):
            return None
        except ConnectionResetError:
            return {}
        if not data:
            return {}
        content: dict[str, Any] = json.loads(data)
        return content

    def close(self) -> None:
        self.socket.close()
