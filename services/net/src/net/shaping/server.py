"""Changes by hand: a unix socket that takes a line of JSON and answers with one; and its client, `net change`."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..interfaces import NetError

SOCKET = Path("/run/net.sock")
PATIENCE_S = 5.0
MOST_BYTES = 1 << 17


class Server:
    """The socket's server. `answer` carries out a request, or raises NetError, whose text becomes the answer.

    Raises NetError if the socket cannot be made.
    """

    def __init__(self, path: Path, answer: Callable[[object], None]) -> None:
        self._path, self._answer = path, answer
        path.unlink(missing_ok=True)
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self.socket.bind(str(path))
            path.chmod(0o666)  # every user in the container may ask, the nodes' user too
        except OSError as error:
            raise NetError(f"--control {path}: {error.strerror}; expected a place for a socket") from error
        self.socket.listen()

    def serve(self) -> None:
        """Serve one request; a client that sends nothing is dropped after a second and delays nothing for long."""
        connection, _ = self.socket.accept()
        with connection:
            connection.settimeout(1.0)
            try:
                said = self._said(_read_line(connection))
                connection.sendall(json.dumps(said).encode() + b"\n")
            except OSError:  # the client is gone
                return

    def _said(self, line: str) -> Mapping[str, Any]:
        try:
            request = json.loads(line)
        except ValueError:
            return {"error": f"{line[:80]!r}: expected a line of JSON"}
        try:
            self._answer(request)
        except NetError as error:
            return {"error": str(error)}
        return {"ok": True}

    def close(self) -> None:
        self.socket.close()
        self._path.unlink(missing_ok=True)


def ask(path: Path, request: Mapping[str, Any]) -> dict[str, Any]:
    """Send a request; returns `{"ok": true}`, or `{"error": …}` with the reason. Raises NetError without an answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(PATIENCE_S)
        try:
            connection.connect(str(path))
            connection.sendall(json.dumps(request).encode() + b"\n")
            line = _read_line(connection)
        except OSError as error:
            raise NetError(f"{path}: {error.strerror or error}; expected `net route --links` to run here") from error
    if not line:
        raise NetError(f"{path}: no answer; expected one line of JSON")
    answer: dict[str, Any] = json.loads(line)
    return answer


def _read_line(connection: socket.socket) -> str:
    data = b""
    while not data.endswith(b"\n") and len(data) < MOST_BYTES and (more := connection.recv(MOST_BYTES)):
        data += more
    return data.decode(errors="replace").strip()
