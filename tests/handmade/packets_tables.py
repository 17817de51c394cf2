"""Segments to make a packets table of, and what is read of one."""

from __future__ import annotations

from typing import Any

import polars as pl

from testbed.numbers.packets.mqtt import Segment


def stream(*bodies: bytes, first: int = 1000) -> list[Segment]:
    """Segments that follow each other; frame n leaves its link at n."""
    found, sequence = [], first
    for row, body in enumerate(bodies):
        found.append(Segment(row, row, sequence % 2**32, False, body))
        sequence += len(body)
    return found


def rows(table: pl.DataFrame, *names: str) -> list[tuple[Any, ...]]:
    """These columns of each row."""
    return table.select(names).rows()
