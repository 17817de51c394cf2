"""Runs the benchmarks and prints their figures: all of them, or those named as `python -m tests.bench activator`."""

from __future__ import annotations

import importlib
import sys

FIGURES = (
    "activator",
    "uav_client",
    "latency",
    "security",
    "signing",
    "bytes_apiece",
    "bytes_fleet",
    "deadlines",
    "sitl_cpu",
    "analysis",
    "emulator",
    "start",
    "page",
)
"""Modules of this folder; each has `measure`, which returns lines of text."""


def main(names: list[str]) -> None:
    for name in names or FIGURES:
        for line in importlib.import_module(f"tests.bench.{name}").measure():
            print(line, flush=True)


main(sys.argv[1:])
