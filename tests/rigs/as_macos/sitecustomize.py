"""Python as on macOS, in every process that has this folder in PYTHONPATH.

Names that macOS lacks are removed before anything else is loaded. Names that both have still behave as on Linux.
"""

from __future__ import annotations

import builtins
import io
import os
import select
import selectors
import signal
import socket
import sys
import sysconfig
import time
import types
from collections.abc import Callable
from typing import Any

NAMES: dict[Any, tuple[str, ...]] = {
    os: (
        *("O_DIRECT", "O_PATH", "O_RSYNC", "O_TMPFILE", "copy_file_range", "eventfd", "fdatasync", "getrandom"),
        *("getresgid", "getresuid", "getxattr", "memfd_create", "pidfd_open", "pipe2", "posix_fadvise"),
        *("posix_fallocate", "sched_getaffinity", "sched_setaffinity", "sched_setscheduler", "setns", "splice"),
        "unshare",
    ),
    select: ("epoll",),
    signal: ("SIGPOLL", "SIGPWR", "SIGRTMAX", "SIGRTMIN", "SIGSTKFLT", "sigtimedwait", "sigwaitinfo"),
    socket: (
        *("AF_NETLINK", "AF_PACKET", "IP_BIND_ADDRESS_NO_PORT", "MSG_ERRQUEUE", "SO_BINDTODEVICE", "SO_DOMAIN"),
        *("SO_MARK", "SO_PRIORITY", "SO_PROTOCOL", "SOCK_CLOEXEC", "SOCK_NONBLOCK", "TCP_CORK", "TCP_KEEPIDLE"),
        *("TCP_QUICKACK", "TCP_USER_TIMEOUT"),
    ),
    time: ("CLOCK_BOOTTIME", "CLOCK_MONOTONIC_COARSE", "CLOCK_TAI", "pthread_getcpuclockid"),
}
FOLDERS = ("/dev/shm", "/proc", "/sys")


def without(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function on a system without FOLDERS."""

    def find(path: Any, *arguments: Any, **options: Any) -> Any:
        if not isinstance(path, int) and os.fsdecode(path).startswith(FOLDERS):
            raise FileNotFoundError(2, "No such file or directory", path)
        return function(path, *arguments, **options)

    return find


sysconfig.get_config_vars()  # cached now: they are looked up by the name of the system
for home, names in NAMES.items():
    for name in names:
        vars(home).pop(name, None)
for home, name in ((builtins, "open"), (io, "open"), (os, "open"), (os, "stat"), (os, "lstat")):
    setattr(home, name, without(getattr(home, name)))
selectors.DefaultSelector = selectors.PollSelector  # type: ignore[misc, assignment]
sys.platform = "darwin"
proxies = types.ModuleType("_scproxy")
vars(proxies).update({"_get_proxies": dict, "_get_proxy_settings": dict})
sys.modules["_scproxy"] = proxies
