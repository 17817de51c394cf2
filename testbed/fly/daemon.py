"""What Docker's daemon reports of a container, and grants to it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from docker.errors import APIError

REAL_TIME = Path("/sys/fs/cgroup/cpu/docker/cpu.rt_runtime_us")
"""The real-time share of all of Docker's containers, on a kernel with CONFIG_RT_GROUP_SCHED (cgroup v1)."""


def real_time_us(given: Path = REAL_TIME) -> int:
    """How many microseconds of every second the link emulator may run in real time.

    0 if the daemon's containers have no such share, or need none because CAP_SYS_NICE alone is enough.
    """
    return int(given.read_text()) if given.is_file() else 0


@dataclass(frozen=True)
class Usage:
    """What a service has used: CPU seconds so far, and bytes of memory now (None: unknown to the daemon)."""

    cpu_s: float
    memory_bytes: int | None


def is_healthy(container: Any) -> bool:
    """Whether a container is healthy, or has no health check.

    Docker first checks after a whole interval, which is long; until then its test is run here.
    """
    status = container.attrs["State"].get("Health", {}).get("Status")
    if status != "starting" or container.status != "running":
        return status in (None, "healthy")
    kind, *words = container.attrs["Config"]["Healthcheck"]["Test"]
    try:
        return bool(container.exec_run(words if kind == "CMD" else ["sh", "-c", *words]).exit_code == 0)
    except APIError:  # it has ended meanwhile
        return False


def usage_of(stats: dict[str, Any]) -> Usage:
    """Usage by the daemon's stats; memory as in `docker stats`, that is without reclaimable file pages."""
    memory = stats.get("memory_stats", {})
    reclaimable = memory.get("stats", {})
    spare = reclaimable.get("total_inactive_file", reclaimable.get("inactive_file", 0))  # cgroup 1, 2
    used = max(0, memory["usage"] - spare) if "usage" in memory else None
    return Usage(round(stats["cpu_stats"]["cpu_usage"]["total_usage"] / 1e9, 2), used)
