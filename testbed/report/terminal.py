"""The summary on the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from ..results import Series
from .words import PROTOCOL_NAMES, finding, notes, seconds, short_loss, size


def print_summary(series: Series, metrics: dict[str, Any], console: Console) -> None:
    """A sentence, a row an attempt, what there is to say of them, and the traffic of the links."""
    console.print()
    console.print(finding(metrics), soft_wrap=True, markup=False)
    console.print(attempts_table(metrics))
    for note in notes(metrics):
        console.print(note, soft_wrap=True, markup=False)
    console.print(links_table(metrics))


def attempts_table(metrics: dict[str, Any]) -> Table:
    """Every attempt; failed ones stay in it, void ones are named and not counted."""
    table = Table(title=f"attempts (arm {metrics['arm']}, profile {metrics['profile']})", title_justify="left")
    for heading in ("protocol", "attempt", "status"):
        table.add_column(heading)
    for heading in ("mission", "packets", "bytes", "commands lost", "states lost", "frames lost"):
        table.add_column(heading, justify="right")
    for protocol, side in metrics["protocols"].items():
        name = PROTOCOL_NAMES.get(protocol, protocol)
        for attempt in side["attempts"]:
            table.add_row(
                name,
                str(attempt["attempt"]),
                attempt["status"],
                seconds(attempt["mission_s"]),
                f"{attempt['packets']:,}",
                size(attempt["size_bytes"]),
                short_loss(attempt["message_loss"]["commands"], attempt["commands_sent"]),
                short_loss(attempt["message_loss"]["states"], attempt["states_sent"]),
                short_loss(attempt["wire_loss"], attempt["packets"]),
            )
        for void in side["void"]:
            table.add_row(name, str(void["attempt"]), "void", *["–"] * 6)
    return table


def links_table(metrics: dict[str, Any]) -> Table:
    """Packets and bytes up and down each link, of each protocol's first attempt."""
    table = Table(title="links, first attempt (up is towards the cloud)", title_justify="left")
    table.add_column("protocol")
    table.add_column("link")
    for heading in ("packets up", "down", "bytes up", "down", "lost"):
        table.add_column(heading, justify="right")
    for protocol, side in metrics["protocols"].items():
        for attempt in side["attempts"][:1]:
            for name, up, down in link_pairs(attempt):
                table.add_row(
                    PROTOCOL_NAMES.get(protocol, protocol),
                    name,
                    f"{up['packets']:,}",
                    f"{down['packets']:,}",
                    size(up["bytes"]),
                    size(down["bytes"]),
                    str(up["lost"] + down["lost"]),
                )
    return table


def link_pairs(attempt: dict[str, Any]) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Each link with its two directions, wan first, then backhaul, then air."""
    nothing = {"packets": 0, "bytes": 0, "lost": 0, "layers": {}}
    names = sorted({name.rsplit(":", 1)[0] for name in attempt["links"]}, key=_order)
    return [(n, attempt["links"].get(f"{n}:up", nothing), attempt["links"].get(f"{n}:down", nothing)) for n in names]


def _order(name: str) -> tuple[int, str]:
    classes = ("wan", "backhaul", "air", "sense")
    return classes.index(name.split(":")[0]), name
