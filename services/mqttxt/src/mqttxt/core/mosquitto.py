"""Mosquitto on this machine: its path, how to install it, and its configuration for nodes without identities."""

from __future__ import annotations

import os
import shutil
import sys

from ..security.broker import ALIASES, LIMITS, MOST_CONNECTIONS

PROGRAM = "mosquitto"
RUNNING = " running"
"""The end of the line that Mosquitto 2 logs once its listener is open."""
SYSTEM_FOLDERS = ("/usr/sbin", "/usr/local/sbin", "/opt/homebrew/sbin")
"""Where packages install it; often not in a user's PATH."""
_HOW = {
    "linux": "sudo apt-get install mosquitto (Fedora: sudo dnf install mosquitto, Arch: sudo pacman -S mosquitto)",
    "darwin": "brew install mosquitto",
}


def find(program: str = PROGRAM) -> str | None:
    """The program's path; None if it is not installed."""
    return shutil.which(program) or shutil.which(program, path=os.pathsep.join(SYSTEM_FOLDERS))


def how_to_get() -> str:
    """The command that installs Mosquitto 2 on this system, or the download page."""
    return _HOW.get(sys.platform, "see https://mosquitto.org/download")


def configuration(host: str, port: int) -> str:
    """The configuration of a broker that accepts every client; for nodes with identities see `security.broker`."""
    return f"{LIMITS}listener {port} {host}\nmax_connections {MOST_CONNECTIONS}\n{ALIASES}allow_anonymous true\n"
