"""The command `testbed packets`: frames as a table, dissected, and by kind of message."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from ..errors import UserError
from ..plan.documents import ROOT
from ..present.packets_view.choice import FrameChoice, choose, find_attempts

RESULTS = ROOT / "results"
ROWS = 40


def packets(
    run: Annotated[str, typer.Argument(help="A series (results/scenario-1/latest), an attempt in it, or latest.")],
    link: Annotated[
        str | None, typer.Option(help="air:uav3:up, air:uav3 for both ways, or air for all drones.")
    ] = None,
    protocol: Annotated[str | None, typer.Option(help="mqtt, mavlink, tcp, udp, icmp.")] = None,
    kind: Annotated[str | None, typer.Option(help="A message: publish, HEARTBEAT, COMMAND_LONG.")] = None,
    from_s: Annotated[float | None, typer.Option("--from", help="Seconds since the mission's start.")] = None,
    to_s: Annotated[float | None, typer.Option("--to", help="Seconds since the mission's start.")] = None,
    show: Annotated[int | None, typer.Option(help="Dissect so many of them in full.")] = None,
    rows: Annotated[int, typer.Option(help="List so many of them.")] = ROWS,
    summary: Annotated[bool, typer.Option("--summary", help="Only count them by kind.")] = False,
) -> None:
    """Show what went over the links of a run: its frames in a table, and their messages by kind."""
    for option, value in (("--show", show), ("--rows", rows)):
        if value is not None and value < 1:
            raise UserError(f"{option} {value}: expected a whole number from 1 on")
    if show is not None and summary:
        raise UserError("--show and --summary: expected one of them")
    choice = FrameChoice(link, protocol, kind, from_s, to_s)
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=160)
    # This loads scapy, which reads all interfaces of the machine: no other command should wait for that.
    from .frames import print_chosen

    for chosen in choose(find_attempts(run, RESULTS), choice):
        print_chosen(chosen, choice, console, show, 0 if summary else rows)
