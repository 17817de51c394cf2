"""Runs every benchmark and prints its figures."""

from __future__ import annotations

from tests.bench import sitl_cpu


def main() -> None:
    print(sitl_cpu.measure())


main()
