"""Python programs of the repository as processes that start in milliseconds: forks of a process that has imported them.

Each runs as `python -m MODULE ARGUMENT…`, with the same files, environment, signals and exit code; only the imports,
most of a short program's time, are done beforehand. A worker's server starts with the first program, and ends with
the worker.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import runpy
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, Protocol

ROOT = Path(__file__).resolve().parents[2]
IMPORTED = (
    "mqttxt.cli.main",
    "mqttxt.activator.process",
    "mqttxt.drone.process",
    "mqttxt.gateway.process",
    "mqttxt.station.ground_station",
    "sensor.process",
    "sitl.cli",
    "sitl.process",
)
"""The modules that take long to import; each program imports the rest itself."""
_LONGEST = 2**18
"""Bytes of a request: the arguments and the environment."""
_ASKING = threading.Lock()


class Running(Protocol):
    """The part of a process's interface that tests use, as in `subprocess.Popen`."""

    pid: int

    def poll(self) -> int | None: ...

    def wait(self, timeout: float | None = None) -> int: ...

    def send_signal(self, sig: int) -> None: ...

    def kill(self) -> None: ...

    def terminate(self) -> None: ...


class Forked:
    """A program that the server has forked; its exit code is as in `subprocess.Popen`."""

    def __init__(self, pid: int, ended: int) -> None:
        self.pid = pid
        self._ended = ended
        self._code: int | None = None

    def poll(self) -> int | None:
        return self._code if self._is_known(0.0) else None

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the exit code. Raises subprocess.TimeoutExpired."""
        if not self._is_known(timeout):
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        assert self._code is not None
        return self._code

    def send_signal(self, sig: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, sig)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def _is_known(self, timeout: float | None) -> bool:
        if self._code is None:
            with selectors.DefaultSelector() as selector:
                selector.register(self._ended, selectors.EVENT_READ)
                if not selector.select(timeout):
                    return False
            self._code = int(os.read(self._ended, 16))
            os.close(self._ended)
        return True


def start(
    module: str,
    arguments: list[str],
    stdout: IO[bytes],
    stderr: IO[bytes],
    environment: Mapping[str, str] | None = None,
) -> Forked:
    """Start a module by its __main__, with files for its output."""
    ended, ends = os.pipe()
    request = json.dumps([module, arguments, str(ROOT), dict(os.environ if environment is None else environment)])
    assert len(request) < _LONGEST
    with _ASKING:
        server = _server()
        socket.send_fds(server, [request.encode()], [stdout.fileno(), stderr.fileno(), ends])
        answer = server.recv(16)
    os.close(ends)
    assert answer, "the process that forks programs has ended"
    return Forked(int(answer), ended)


def run(
    module: str, *arguments: str, timeout_s: float = 60, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a module until it ends; returns its exit code and output. Kills it and raises subprocess.TimeoutExpired."""
    with tempfile.TemporaryFile() as stdout, tempfile.TemporaryFile() as stderr:
        process = start(module, [*arguments], stdout, stderr, environment)
        try:
            code = process.wait(timeout_s)
        finally:
            process.kill()
        for file in (stdout, stderr):
            file.seek(0)
        said, errors = stdout.read().decode(), stderr.read().decode()
    return subprocess.CompletedProcess([module, *arguments], code, said, errors)


@cache
def _server() -> socket.socket:
    """The connection to this worker's server; the server ends when it is closed."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [sys.executable, "-m", __name__, str(theirs.fileno())]
    subprocess.Popen(command, cwd=ROOT, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)
    theirs.close()
    return ours


@dataclass(frozen=True)
class _Program:
    module: str
    arguments: list[str]
    folder: str
    environment: dict[str, str]
    files: list[int]


def _serve(connection: socket.socket) -> _Program | None:
    """Fork for each request; returns the program in its fork, and None in the server once the client has gone."""
    children: dict[int, int] = {}
    woken, wakes = os.pipe()
    for end in (woken, wakes):
        os.set_blocking(end, False)
    signal.set_wakeup_fd(wakes)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.freeze()
    with selectors.DefaultSelector() as selector:
        selector.register(connection, selectors.EVENT_READ)
        selector.register(woken, selectors.EVENT_READ)
        while True:
            ready = [key.fd for key, _ in selector.select()]
            if woken in ready:
                _drain(woken)
                _reap(children)
            if connection.fileno() not in ready:
                continue
            request, files, _, _ = socket.recv_fds(connection, _LONGEST, 3)
            if not request:
                return None
            pid = os.fork()
            if pid == 0:
                return _Program(*json.loads(request), files)
            children[pid] = files.pop()
            for file in files:
                os.close(file)
            connection.send(str(pid).encode())


def _drain(pipe: int) -> None:
    with contextlib.suppress(BlockingIOError):
        while os.read(pipe, 512):
            pass


def _reap(children: dict[int, int]) -> None:
    """Report the exit code of each process that has ended."""
    while children:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid == 0:
            return
        ends = children.pop(pid)
        with contextlib.suppress(BrokenPipeError):  # the test has closed its end
            os.write(ends, str(os.waitstatus_to_exitcode(status)).encode())
        os.close(ends)


def _become(program: _Program) -> None:
    """Take the program's files, signals, folder and environment, and nothing of the server's."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(program.files[0], 1)
    os.dup2(program.files[1], 2)
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    os.chdir(program.folder)
    os.environ.clear()
    os.environ.update(program.environment)


def main() -> None:
    for module in IMPORTED:
        importlib.import_module(module)
    with socket.socket(fileno=int(sys.argv[1])) as connection:
        program = _serve(connection)
    if program is not None:
        _become(program)
        sys.argv[1:] = program.arguments
        runpy.run_module(program.module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
