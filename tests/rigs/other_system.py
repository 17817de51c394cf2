"""mqttxt as on Windows: `python other_system.py mqttxt ARGUMENTS…`, or a Python file and its arguments.

Names that Windows lacks are removed before mqttxt is loaded. Names that both have still behave as on Linux.
"""

from __future__ import annotations

import asyncio
import logging
import os
import runpy
import signal
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

MODULES = ("fcntl", "grp", "pwd", "resource", "termios")
NAMES: dict[Any, tuple[str, ...]] = {
    os: ("O_CLOEXEC", "O_DIRECTORY", "fchmod", "fchown", "fork", "geteuid", "getuid", "killpg"),
    signal: ("SIGHUP", "SIGKILL", "SIGUSR1"),
    socket: ("TCP_CORK",),
    time: ("CLOCK_BOOTTIME", "CLOCK_MONOTONIC", "CLOCK_MONOTONIC_RAW", "clock_gettime", "clock_gettime_ns"),
}
LOADED = (logging, ssl, subprocess, tempfile)
"""Parts of Python that look up some of these names when they are loaded; on Windows they do without."""
_open = os.open


class WindowsSelectorLoop(asyncio.SelectorEventLoop):
    """A loop without signal handlers."""

    add_signal_handler = asyncio.AbstractEventLoop.add_signal_handler
    remove_signal_handler = asyncio.AbstractEventLoop.remove_signal_handler


class ProactorEventLoop(WindowsSelectorLoop):
    """The default loop, which cannot watch sockets, either."""

    add_reader = asyncio.AbstractEventLoop.add_reader
    remove_reader = asyncio.AbstractEventLoop.remove_reader
    add_writer = asyncio.AbstractEventLoop.add_writer
    remove_writer = asyncio.AbstractEventLoop.remove_writer


def open_file(path: Any, *arguments: Any, **options: Any) -> int:
    """`os.open`, which does not open folders."""
    if not isinstance(path, int) and Path(os.fsdecode(path)).is_dir():
        raise PermissionError(13, "Permission denied", path)
    return _open(path, *arguments, **options)


def become_windows() -> None:
    """Remove from this process what Windows lacks."""
    for module in MODULES:
        sys.modules[module] = None  # type: ignore[assignment]
    for home, names in NAMES.items():
        for name in names:
            delattr(home, name)
    os.open = open_file
    asyncio.SelectorEventLoop = WindowsSelectorLoop  # type: ignore[misc]
    asyncio.events.new_event_loop = ProactorEventLoop


if __name__ == "__main__":
    become_windows()
    del sys.argv[0]
    if sys.argv[0] == "mqttxt":
        from mqttxt.cli import main

        main()
    else:
        runpy.run_path(sys.argv[0], run_name="__main__")
