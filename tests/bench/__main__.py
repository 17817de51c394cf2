"""Runs the benchmarks and prints their figures: all of them, or those named as `python -m tests.bench activator`.

`load` takes options: `python -m tests.bench load --minutes 10`.
"""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from docker.errors import DockerException

from tests.bench.clouds import CLOUDS

FIGURES = (
    "activator",
    "uav_client",
    "latency",
    "security",
    "signing",
    "bytes_apiece",
    "bytes_fleet",
    "word_budget",
    "two_links",
    "deadlines",
    "sitl_cpu",
    "analysis",
    "emulator",
    "net_limit",
    "start",
    "page",
    "load",
)
"""Modules of this folder; each has `measure`, which returns lines of text."""
IF_NAMED = ("fit", "holds")
"""Those that take long or need a real PX4: run only if they are named."""


LOAD = {"fogs": int, "drones": int, "minutes": float, "every_s": float, "fleets": int, "write": Path, "cloud": str}
"""Options of the load: fogs, drones at each, its duration, the interval of each drone's commands, the least number of
fleets, a file that gets the figures, and the cloud."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join((*FIGURES, *IF_NAMED)))
    for option, kind in LOAD.items():
        choices = CLOUDS if option == "cloud" else None
        parser.add_argument(f"--{option.replace('_', '-')}", type=kind, choices=choices, help="of `load`")
    given = vars(parser.parse_args())
    names = given.pop("names") or FIGURES
    if unknown := [name for name in names if name not in (*FIGURES, *IF_NAMED)]:
        parser.error(f"{unknown[0]}: expected one of {', '.join((*FIGURES, *IF_NAMED))}")
    load = {option: value for option, value in given.items() if value is not None}
    for name in names:
        module = importlib.import_module(f"tests.bench.{name}")
        try:
            for line in module.measure(**load) if name == "load" else module.measure():
                print(line, flush=True)
        except DockerException as error:
            print(f"{name}: not measured, Docker does not answer: {error}", flush=True)


main()
