"""One run at a time: a fleet's addresses exist once."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path

from ..errors import DockerError

LOCK = Path(tempfile.gettempdir()) / "mqttxt-testbed.lock"


def only_run(*, wait: bool = False) -> None:
    """Lock out other runs until this process ends: a fleet's addresses exist once.

    Raises DockerError that names the run in progress; with `wait`, waits for its end instead.
    """
    handle = os.open(LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        pid = os.read(handle, 20).decode() or "unknown"
        raise DockerError(f"another run is going on (process {pid}); only one fleet can fly at a time") from None
    os.truncate(handle, 0)
    os.write(handle, str(os.getpid()).encode())
