"""The Docker daemon: used if it answers, started if it is installed, else installed."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path

from .steps import CACHE, BootstrapError, apt_install, run, step, succeeds

START_TIMEOUT_S = 60
LOG = CACHE / "dockerd.log"
PID_FILES = {"dockerd": Path("/var/run/docker.pid"), "containerd": Path("/var/run/docker/containerd/containerd.pid")}
REAL_TIME = Path("/sys/fs/cgroup/cpu/cpu.rt_runtime_us")
REAL_TIME_US = 900_000
"""Microseconds per second; the kernel's limit for all programs together is 950 ms."""


def ensure_docker() -> None:
    """Make sure that a daemon answers and that a compose command works. Raises BootstrapError if that fails."""
    if not daemon_answers():
        _check_rights()
        if shutil.which("dockerd") is None:
            apt_install(["docker.io", "docker-compose", "iptables"], "no Docker daemon is installed")
        if not daemon_answers():
            start_daemon()
    if compose_command() is None:
        apt_install(["docker-compose"], "neither `docker compose` nor docker-compose is installed")
    if compose_command() is None:
        raise BootstrapError("neither `docker compose` nor docker-compose works")


def daemon_answers() -> bool:
    return shutil.which("docker") is not None and succeeds(["docker", "info"], timeout_s=20)


def compose_command() -> list[str] | None:
    """`docker compose` if it works, else docker-compose, else None."""
    for command in (["docker", "compose"], ["docker-compose"]):
        if succeeds([*command, "version"]):
            return command
    return None


def _check_rights() -> None:
    """Raise BootstrapError if a daemon runs elsewhere or refuses this user: it must not be started a second time."""
    host = os.environ.get("DOCKER_HOST")
    if host and shutil.which("docker") is not None:
        raise BootstrapError(f"DOCKER_HOST={host}: no Docker daemon answers there; start it, or unset DOCKER_HOST")
    socket = "/var/run/docker.sock"
    if os.path.exists(socket) and not os.access(socket, os.W_OK):
        raise BootstrapError("no rights for the Docker daemon; type: sudo usermod -aG docker $USER, then log in again")
    if os.geteuid() != 0 and shutil.which("dockerd") is not None:
        raise BootstrapError("the Docker daemon does not run; type: sudo systemctl start docker (or: sudo dockerd)")


def start_daemon() -> None:
    """Start dockerd detached from this process, and wait until it answers."""
    with step(f"starting the Docker daemon (log: {LOG.relative_to(CACHE.parent)})"):
        CACHE.mkdir(exist_ok=True)
        deadline = time.monotonic() + START_TIMEOUT_S
        give_real_time()
        remove_stale_pid_files()
        process = _spawn()
        while not daemon_answers():
            if time.monotonic() > deadline:
                raise BootstrapError(f"the Docker daemon does not answer; its log: {LOG}\n    {_tail()}")
            if process.poll() is not None:
                if "pid file found" not in _tail():
                    raise BootstrapError(f"the Docker daemon ended; its log: {LOG}\n    {_tail()}")
                process = _spawn()  # a daemon that was killed leaves its pid file for a second
            time.sleep(0.2)


def _spawn() -> subprocess.Popen[bytes]:
    with LOG.open("ab") as log:
        return subprocess.Popen(
            ["dockerd"], stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True, cwd="/"
        )


def remove_stale_pid_files(files: Mapping[str, Path] = PID_FILES, processes: Path = Path("/proc")) -> None:
    """Remove the pid files of daemons killed with their machine: dockerd takes any process of that pid for one."""
    for program, file in files.items():
        if file.exists():
            command = processes / file.read_text().strip() / "comm"
            if not command.is_file() or command.read_text().strip() != program:
                file.unlink()


def give_real_time(of_all: Path = REAL_TIME) -> None:
    """Give Docker's containers real time, if the kernel assigns it by cgroup (CONFIG_RT_GROUP_SCHED, cgroup v1).

    By default they have none. Without it the link emulator, which must not be delayed, is late beside a fleet that
    fills two cores. If other groups have too much of it, the kernel refuses; `net` then runs without.
    """
    if of_all.is_file():
        group = of_all.parent / "docker"
        group.mkdir(exist_ok=True)
        with contextlib.suppress(OSError):
            (group / of_all.name).write_text(str(REAL_TIME_US))


def _tail() -> str:
    lines = LOG.read_text(errors="replace").splitlines()[-4:] if LOG.exists() else []
    return "\n    ".join(lines)


def version() -> str:
    """The daemon's version."""
    return run(["docker", "version", "--format", "{{.Server.Version}}"]).strip()
