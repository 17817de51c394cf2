"""Preparation steps: announcing them, running programs, and checking the machine."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CACHE = ROOT / ".cache"
OLDEST_PYTHON = (3, 11)
_NO_NETWORK = "no network: the package registry cannot be reached; check the connection, proxy and DNS, then try again"
_CAUSES = {
    "no space left on device": "the disk is full; free some space, then try again",
    "permission denied while trying to connect to the docker": "no rights for the Docker daemon; "
    "type: sudo usermod -aG docker $USER, then log in again",
    "certificate verify failed": "a proxy's certificate is not trusted; name its CA bundle in PIP_CERT, then try again",
    "temporary failure (in name resolution|resolving)": _NO_NETWORK,
    r"failed to establish a new connection|network is unreachable|\(from versions: none\)": _NO_NETWORK,
    "could not connect to |unable to connect to ": _NO_NETWORK,
    "do not match the hashes": "a download does not match its pinned hash; it was altered on its way, or in a cache",
}


class BootstrapError(Exception):
    """A step failed: the text says why and what to type."""


@contextlib.contextmanager
def step(what: str) -> Iterator[None]:
    """Print a step and, once it is done, how long it took."""
    print(f"  {what} …", end="", flush=True)
    started = time.monotonic()
    try:
        yield
    except BaseException:
        print(" failed", flush=True)
        raise
    print(f" {time.monotonic() - started:.1f} s", flush=True)


def run(argv: Sequence[str], *, timeout_s: float = 900, env: dict[str, str] | None = None) -> str:
    """Run a program and return its output. Raises BootstrapError with its last lines if it fails."""
    try:
        done = subprocess.run(
            argv,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=timeout_s,
            env={**os.environ, **(env or {})},
            cwd=ROOT,
            check=False,
        )
    except FileNotFoundError as error:
        raise BootstrapError(f"{argv[0]} is not installed") from error
    except subprocess.TimeoutExpired as error:
        raise BootstrapError(f"{' '.join(argv)} did not end within {timeout_s:.0f} s") from error
    if done.returncode != 0:
        cause = known_cause(done.stdout)
        if cause is not None:
            raise BootstrapError(f"{' '.join(argv[:3])}: {cause}")
        tail = "\n    ".join(done.stdout.strip().splitlines()[-12:])
        raise BootstrapError(f"{' '.join(argv[:6])} failed with exit code {done.returncode}:\n    {tail}")
    return done.stdout


def known_cause(output: str) -> str | None:
    """The advice for a common failure in a program's output; None for any other."""
    return next((cause for sign, cause in _CAUSES.items() if re.search(sign, output, re.IGNORECASE)), None)


def succeeds(argv: Sequence[str], timeout_s: float = 30) -> bool:
    """Whether a program ends with exit code 0 within the time limit."""
    try:
        run(argv, timeout_s=timeout_s)
    except BootstrapError:
        return False
    return True


def apt_install(packages: Sequence[str], why: str) -> None:
    """Install Debian packages as root; otherwise raise BootstrapError with the command to type."""
    command = ["apt-get", "install", "--yes", "--no-install-recommends", *packages]
    if shutil.which("apt-get") is None:
        raise BootstrapError(f"{why}: install {', '.join(packages)} with this system's package manager")
    if os.geteuid() != 0:
        raise BootstrapError(f"{why}; type: sudo apt-get update && sudo {' '.join(command)}")
    with step(f"installing {' '.join(packages)}"):
        env = {"DEBIAN_FRONTEND": "noninteractive"}
        run(["apt-get", "update", "-qq"], env=env)
        run(command, env=env)


def check_python() -> None:
    """Raise BootstrapError if this Python is too old."""
    found = ".".join(str(part) for part in sys.version_info[:3])
    if tuple(sys.version_info[:2]) < OLDEST_PYTHON:
        raise BootstrapError(f"python3 is {found}; expected 3.11 or newer")


def check_disk(path: Path, need_mib: int) -> None:
    """Raise BootstrapError if the disk of `path` has less than `need_mib` MiB left."""
    left_mib = shutil.disk_usage(path).free // 2**20
    if left_mib < need_mib:
        raise BootstrapError(f"disk of {path}: {left_mib} MiB free, expected at least {need_mib} MiB")


def print_rows(rows: Sequence[tuple[str, bool, str, str]]) -> None:
    """Print a line per row (name, whether it exists, which one, command to type if it is missing)."""
    for name, there, found, hint in rows:
        print(f"  {name:<20} {'ok      ' if there else 'missing '} {found if there else 'type: ' + hint}")


def command(module: str, name: str, actions: Mapping[str, Callable[[], object]]) -> int:
    """Carry out the action that the command line names; returns the exit code of `python3 -m MODULE`.

    `name` is the prefix of error lines.
    """
    if sys.platform != "linux":
        print(f"{name}: runs on Linux, not on {sys.platform}; mqttxt's ground station runs there too", file=sys.stderr)
        return 2
    if len(sys.argv) != 2 or sys.argv[1] not in actions:
        print(f"usage: python3 -m {module} {' | '.join(actions)}", file=sys.stderr)
        return 2
    try:
        actions[sys.argv[1]]()
    except BootstrapError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0
