"""The channel between `net route` and its emulator: a pair of sockets; each message is JSON.

Orders: `{"start_ns": …}` (unix time), `{"link", "change": {…} or null}` (by hand), `{"link", "shut": true or false}`.
Each is answered, once it has taken effect, by `{"done": unix ns, "events": […]}`. Unasked the emulator sends
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
    """One end of the channel. `receive` does not wait, unless a timeout is set on the socket."""

    def __init__(self, end: socket.socket) -> None:
        self.socket = end
        end.setblocking(False)

    @classmethod
    def pair(cls) -> tuple[Channel, Channel]:
        """Two connected ends."""
        one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        return cls(one), cls(other)

    @classmethod
    def of_descriptor(cls, descriptor: int) -> Channel:
        """The end whose descriptor a process was started with."""
        return cls(socket.socket(fileno=descriptor))

    def send(self, content: Mapping[str, Any]) -> None:
        """Send a message. Raises NetError if the other end is gone or no longer reads."""
        try:
            self.socket.send(json.dumps(content).encode())
        except OSError as error:
            raise NetError(f"net route and its emulator: {error.strerror}; expected both to run") from error

    def receive(self) -> dict[str, Any] | None:
        """The next message; empty if the other end is gone, None if there is no message."""
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
