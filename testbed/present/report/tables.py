"""A table on the terminal, as all reports have it."""

from __future__ import annotations

from rich import box
from rich.table import Table


def plain_table(title: str, *columns: str) -> Table:
    """A table without a box around it, so that it fits 80 columns."""
    return Table(
        *columns, title=f"\n{title}", title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False
    )
