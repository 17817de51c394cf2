"""The cost of starting the command and the library: processor time, as a ratio to Python's own."""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys

TURNS = 15
STARTS = {
    "mqttxt --version": ["-m", "mqttxt", "--version"],
    "mqttxt --help": ["-m", "mqttxt", "--help"],
    "from mqttxt import GroundStation": ["-c", "from mqttxt import GroundStation"],
}


def _cpu_s(arguments: list[str]) -> float:
    """Processor time of one Python process, user and system."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure() -> list[str]:
    """Medians of runs in turns, so that a machine that slows down slows all of them."""
    commands = {"python -c pass": ["-c", "pass"], **STARTS}
    taken: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(TURNS):
        for name, arguments in commands.items():
            taken[name].append(_cpu_s(arguments))
    own = statistics.median(taken.pop("python -c pass"))
    return [
        f"{name}: {(median := statistics.median(times)) / own:.1f} times python -c pass ({median:.3f} s of {own:.3f} s)"
        for name, times in taken.items()
    ]
