"""What commands and words cost on each link of a series: `python -m tests.bench.words results/scenario-1/latest`."""

from __future__ import annotations

import sys
from pathlib import Path

import polars as pl

from testbed.errors import TestbedError
from testbed.fly.results import open_series
from testbed.numbers.metrics import mission_window
from testbed.numbers.packets import load

STAGES = ("air", "backhaul", "wan")
_OWN = ("command", "result")


def shares(frames: pl.DataFrame) -> dict[str, dict[str, tuple[int, float]]]:
    """By stage and purpose: frames, and bytes with their part of what acknowledges on that stage, shared by bytes.

    `frames` has the columns link, purpose and size.
    """
    stage = pl.col("link").cast(pl.String).str.split(":").list.first().alias("stage")
    found: dict[str, dict[str, tuple[int, float]]] = {}
    for (name,), of_stage in frames.with_columns(stage).group_by("stage", maintain_order=True):
        sizes = of_stage.group_by(pl.col("purpose").cast(pl.String)).agg(pl.len().alias("n"), pl.col("size").sum())
        told = {purpose: (n, float(size)) for purpose, n, size in sizes.iter_rows()}
        _, acknowledging = told.pop("acknowledgement", (0, 0.0))
        all_ = sum(size for _, size in told.values())
        found[str(name)] = {
            purpose: (n, size * (1 + acknowledging / all_)) for purpose, (n, size) in told.items() if purpose in _OWN
        }
    return found


def measure(path: Path) -> list[str]:
    """Lines for each attempt. Raises ResultsError."""
    out = []
    for attempt in open_series(path).attempts():
        packets = load(attempt)
        window = mission_window(attempt, attempt.events(), packets)
        assert window is not None, f"{attempt.path}: no mission"
        by_stage = shares(packets.frames.filter(window.entered))
        for stage in STAGES:
            told = [f"{name} {n} frames, {size:,.0f} B" for name, (n, size) in sorted(by_stage[stage].items())]
            out.append(f"attempt {attempt.number}, {attempt.protocol}, {stage}: {'; '.join(told)}")
        total = sum(size for told in by_stage.values() for _, size in told.values())
        out.append(f"attempt {attempt.number}, {attempt.protocol}: {total:,.0f} B")
    return out


if __name__ == "__main__":
    try:
        for said in sys.argv[1:]:
            print(said, *measure(Path(said)), sep="\n  ")
    except TestbedError as error:
        sys.exit(f"words: {error}")
