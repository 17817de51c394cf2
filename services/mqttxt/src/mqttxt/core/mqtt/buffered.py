"""The socket that paho uses: the connection reads and writes it in bulk, and hands paho one packet at a time."""

from __future__ import annotations

import ssl
from collections import deque
from socket import socket

_AT_ONCE_BYTES = 65_536
_RECORDS_AT_ONCE = 64
"""TLS records; the other side may send records of one byte each."""


class Buffered:
    """A connected socket with the bytes that are received and not yet processed, and those not yet written.

    `came` from `start` on is received and not processed. paho reads `for_paho`, and gets `failure` once `is_over`:
    packets that arrived together with the end of the connection are processed first.
    """

    def __init__(self, sock: socket) -> None:
        self.sock = sock
        self.came, self.start = b"", 0
        self.for_paho = b""
        self.failure: OSError | None = None
        """The error that ends the connection, ConnectionResetError if the other side closed it."""
        self.is_over = False
        """Whether all bytes received before the failure are processed."""
        self._leaving: deque[bytes] = deque()
        self.setblocking, self.setsockopt, self.fileno = sock.setblocking, sock.setsockopt, sock.fileno

    def fetch(self) -> int:
        """Read the available bytes, at most about 64 KiB or 64 records; returns their number."""
        chunks, length = [self.came[self.start :]], 0
        try:
            while chunk := self.sock.recv(_AT_ONCE_BYTES):
                chunks.append(chunk)
                length += len(chunk)
                if not isinstance(self.sock, ssl.SSLSocket):  # which returns one record at a time
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
        """Write pending bytes, in as few segments as the system can form; returns whether none are left."""
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
        """The bytes of one write: as many packets as fit, about."""
        data = self._leaving.popleft()
        if not self._leaving or len(data) >= _AT_ONCE_BYTES:
            return data
        packets, length = [data], len(data)
        while self._leaving and length < _AT_ONCE_BYTES:
            packets.append(self._leaving.popleft())
            length += len(packets[-1])
        return b"".join(packets)

    # Called by paho.

    def recv(self, count: int) -> bytes:
        data, self.for_paho = self.for_paho[:count], self.for_paho[count:]
        if not data:
            raise self.failure if self.is_over and self.failure is not None else BlockingIOError()
        return data

    def send(self, data: bytes | bytearray) -> int:
        """Queue bytes for the next `flush`."""
        self._leaving.append(bytes(data))
        return len(data)

    def close(self) -> None:
        """Write pending bytes, as far as the system accepts them now, and close the socket."""
        if self.sock.fileno() >= 0:
            self.flush()
        self.sock.close()
