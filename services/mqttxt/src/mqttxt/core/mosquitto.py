"""Mosquitto on this machine: where it is, how to get it, and how it is configured where nodes have no identities."""

from __future__ import annotations

import os
import shutil
import sys

from ..security.broker import ALIASES, LIMITS, MOST_CONNECTIONS

PROGRAM = "mosquitto"
RUNNING = " running"
"""How the line ends that Mosquitto 2 says once its listener is open."""
SYSTEM_FOLDERS = ("/usr/sbin", "/usr/local/sbin", "/opt/homebrew/sbin")
"""Where packages put it, and where the PATH of a person often does not lead."""
_HOW = {
    "linux": "sudo apt-get install mosquitto (Fedora: sudo dnf install mosquitto, Arch: sudo pacman -S mosquitto)",
    "darwin": "brew install mosquitto",
}


def find(program: str = PROGRAM) -> str | None:
    """The program's path; None where it is not installed."""
    return shutil.which(program) or shutil.which(program, path=os.pathsep.join(SYSTEM_FOLDERS))


def how_to_get() -> str:
    """What installs Mosquitto 2 on this system."""
    return _HOW.get(sys.platform, "see https://mosquitto.org/download")


def configuration(host: str, port: int) -> str:
    """The configuration of a broker that takes every client; with identities, see `security.broker`."""
    return f"{LIMITS}listener {port} {host}\nmax_connections {MOST_CONNECTIONS}\n{ALIASES}allow_anonymous true\n"
