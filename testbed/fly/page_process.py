"""The live page's process: started with a fleet, and ended with it."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from ..errors import TestbedError
from ..plan.documents import ROOT
from ..plan.experiments import Plan
from .results import Attempt

PORT = 8080
HOST = "127.0.0.1"
LOG, PID = "logs/page.log", "page.pid"
"""Files in the run's folder."""
START_S, END_S, POLL_S = 60.0, 10.0, 0.1


def page_url(port: int) -> str:
    return f"http://{HOST}:{port}/"


def page_port() -> int:
    """`PORT`, or a free port if that one is in use."""
    with socket.socket() as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind((HOST, PORT))
        except OSError:
            sock.bind((HOST, 0))
        return int(sock.getsockname()[1])


@contextlib.contextmanager
def page_beside(plan: Plan, attempt: Attempt) -> Iterator[None]:
    """Run the page as long as the context lasts, if the plan has one; it only watches. Raises as `start_page`."""
    if plan.page is None:
        yield
        return
    page = start_page(plan, attempt, watch_only=True)
    try:
        yield
    finally:
        page.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            page.wait(END_S)
        page.kill()
        page.wait()


def start_page(plan: Plan, attempt: Attempt, *, watch_only: bool) -> subprocess.Popen[bytes]:
    """Start the page of a running fleet, and wait until it is served; it outlives this process.

    Raises TestbedError with its last output if it is not served.
    """
    command = [sys.executable, "-m", "testbed", "page", str(attempt.path), "--protocol", attempt.protocol]
    command += ["--port", str(plan.page), "--security", plan.factors.security, *(["--watch-only"] * watch_only)]
    path = attempt.path / LOG
    with path.open("wb") as log:
        page = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
    (attempt.path / PID).write_text(str(page.pid), encoding="ascii")
    deadline_s = time.monotonic() + START_S
    while f"open {page_url(plan.page or PORT)}" not in (said := path.read_text(encoding="utf-8", errors="replace")):
        if page.poll() is not None or time.monotonic() > deadline_s:
            page.kill()
            page.wait()
            last = (said.strip().splitlines() or ["it said nothing"])[-1]
            raise TestbedError(f"the page is not served: {last}")
        time.sleep(POLL_S)
    return page


def end_page(folder: Path) -> None:
    """End the page that another process of the testbed started for a run's folder, if it still runs."""
    path = folder / PID
    try:
        number = int(path.read_text(encoding="ascii"))
        command = Path(f"/proc/{number}/cmdline").read_bytes().split(b"\0")
    except (OSError, ValueError):
        return
    path.unlink(missing_ok=True)
    if b"testbed" in command and str(folder).encode() in command:
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, signal.SIGTERM)
