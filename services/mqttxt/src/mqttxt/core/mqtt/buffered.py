"""The socket that paho has: the connection reads and writes it in bulk, and gives paho a packet at a time."""

from __future__ import annotations

import ssl
from collections import deque
from socket import socket

_AT_ONCE_BYTES = 65_536
_RECORDS_AT_ONCE = 64
"""Of TLS, which the other side may make of a byte each."""


class Buffered:
    """A connected socket with what has come and nobody has taken, and what was handed over and has not left.

    `came` from `start` on is what has come. paho reads `for_paho`, and `failure` once `is_over`: where the end comes
    together with what was said before it, that is taken first.
    """

    def __init__(self, sock: socket) -> None:
        self.sock = sock
        self.came, self.start = b"", 0
        self.for_paho = b""
        self.failure: OSError | None = None
        """What ends the connection, ConnectionResetError where the other side closed it."""
        self.is_over = False
        """All that came before the failure has been taken."""
        self._leaving: deque[bytes] = deque()
        self.setblocking, self.setsockopt, self.fileno = sock.setblocking, sock.setsockopt, sock.fileno

    def fetch(self) -> int:
        """Read what is there, some 64 KiB or 64 records at the most; returns how many bytes that was."""
        chunks, length = [self.came[self.start :]], 0
        try:
            while chunk := self.sock.recv(_AT_ONCE_BYTES):
                chunks.append(chunk)
                length += len(chunk)
                if not isinstance(self.sock, ssl.SSLSocket):  # which gives record by record
                    break
                if length >= _AT_ONCE_BYTES or len(chunks) > _RECORDS_AT_ONCE:
                    break
            else:
                self.failure = ConnectionResetError("closed by the other side")
        except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            pass
        except OSError as error:
            self.failure = error
        self.came, self.start = b"".join(chunks), 0
        return length

    def flush(self) -> bool:
        """Write what was handed over, in as few segments as the system can make of it; whether all has left."""
        try:
            while self._leaving:
                data = self._next()
                sent = self.sock.send(data)
                if sent < len(data):
                    self._leaving.appendleft(data[sent:])
                    return False
        except (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError):
            self._leaving.appendleft(data)
        except OSError as error:
            self.failure = error
            self._leaving.clear()
        return not self._leaving

    def _next(self) -> bytes:
        """What leaves at once: packets up to a number of bytes together."""
        data = self._leaving.popleft()
        if not self._leaving or len(data) >= _AT_ONCE_BYTES:
            return data
        packets, length = [data], len(data)
        while self._leaving and length < _AT_ONCE_BYTES:
            packets.append(self._leaving.popleft())
            length += len(packets[-1])
        return b"".join(packets)

    # What paho calls.

    def recv(self, count: int) -> bytes:
        data, self.for_paho = self.for_paho[:count], self.for_paho[count:]
        if not data:
            raise self.failure if self.is_over and self.failure is not None else BlockingIOError()
        return data

    def send(self, data: bytes | bytearray) -> int:
        """Hand over what leaves with the next `flush`."""
        self._leaving.append(bytes(data))
        return len(data)

    def close(self) -> None:
        """Close it behind what was handed over, as far as the system takes that now."""
        if self.sock.fileno() >= 0:
            self.flush()
        self.sock.close()
