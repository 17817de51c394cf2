"""The `router` command: run a node's mavp2p processes until a signal, or until one of them ends."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from .chains import CHAINS, ChainError, parse_drones, read_chain
from .process import Node, Turn

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def main(
    chain: Annotated[str, typer.Option(help=f"Which routers: {', '.join(CHAINS)}.")],
    drones: Annotated[str, typer.Option(help="System ids of the autopilots that are to be heard, as 1,2,3.")],
    ready_file: Annotated[
        Path, typer.Option(help="File touched every second while every router hears its autopilots.")
    ],
    after: Annotated[
        Path | None, typer.Option(help="Start once this file is there: the next node's --listening.")
    ] = None,
    listening: Annotated[Path | None, typer.Option(help="File that is there while every router listens.")] = None,
    only: Annotated[str, typer.Option(help="Of the drones those that fly, as 1; empty: all.")] = "",
    program: Annotated[str, typer.Option(help="The mavp2p to run.")] = "mavp2p",
) -> None:
    """Run mavp2p for each line of the chain, which is read from the environment's PER_UAV or SHARED."""
    try:
        flying = parse_drones(only) if only else None
        routers = read_chain(chain, parse_drones(drones), dict(os.environ), flying)
    except ChainError as error:
        typer.echo(f"router: {error}", err=True)
        raise typer.Exit(2) from None
    ended = asyncio.run(_until_signal(Node(program, routers, ready_file, Turn(after, listening))))
    if ended is not None:
        typer.echo(f"router: {ended}", err=True)
        raise typer.Exit(1)


async def _until_signal(node: Node) -> str | None:
    """Run the node until a signal; returns the reason if it ends before."""
    running = asyncio.create_task(node.run())
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, running.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        return await running
    return None


if __name__ == "__main__":
    sys.exit(app())
