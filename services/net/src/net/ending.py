"""The end of a process by a signal, which must wake a process that waits on sockets."""

from __future__ import annotations

import signal
import socket


class Ending:
    """SIGTERM and SIGINT as a socket that becomes readable, so that a signal ends a wait on sockets."""

    def __enter__(self) -> Ending:
        self._come = False
        self.wake, self._other = socket.socketpair()
        self.wake.setblocking(False)
        self._other.setblocking(False)
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGTERM, signal.SIGINT)}
        self._descriptor = signal.set_wakeup_fd(self._other.fileno())
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._descriptor)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self.wake.close()
        self._other.close()

    def has_come(self) -> bool:
        return self._come

    def drain(self) -> None:
        """Empty the socket, so that a signal does not wake twice."""
        self.wake.recv(64)

    def end(self) -> None:
        self._come = True

    def _note(self, *_: object) -> None:
        self._come = True
