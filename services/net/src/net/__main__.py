"""`net route`: check the ports, route hop by hop, capture on each, until told to end; `net shape`: shape every link."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer

from .captures import Capture, stop_all, write_counts
from .emulator.plan import PlanError, read_plan
from .emulator.process import shape as shape_links
from .hops import parse_links, route_by_hops
from .interfaces import NetError, parse_nodes, read_ports, turn_off_offloads

WATCH_S = 1.0

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.callback()
def about() -> None:
    """The testbed's network."""


@app.command()
def route(
    captures: Annotated[Path, typer.Option(help="Folder for one pcap a node and captures.json.")],
    ready_file: Annotated[Path, typer.Option(help="File that is made once everything is captured.")],
) -> None:
    """Route between all nodes, hop by hop, and capture at each, until SIGTERM or SIGINT."""
    try:
        _route(captures, ready_file)
    except NetError as error:
        typer.echo(f"net: {error}", err=True)
        raise typer.Exit(1) from None


@app.command()
def shape(
    plan: Annotated[Path, typer.Option(help="The links' plan, JSON.")],
    counters: Annotated[Path, typer.Option(help="File for what each link did, written each second and at the end.")],
    ready_file: Annotated[Path, typer.Option(help="File that is made once every link is shaped.")],
) -> None:
    """Shape every link as planned, on NFQUEUE, until SIGTERM or SIGINT."""
    try:
        planned = read_plan(plan)
        nodes = parse_nodes(os.environ.get("NODES", ""))
        links = parse_links(os.environ.get("LINKS", ""), list(nodes))
        ports = read_ports(nodes)
        for port in ports:
            turn_off_offloads(port)
        shape_links(planned, ports, links, counters, ready_file)
    except PlanError as error:
        typer.echo(f"net: {error}", err=True)
        raise typer.Exit(2) from None
    except NetError as error:
        typer.echo(f"net: {error}", err=True)
        raise typer.Exit(1) from None


def _route(folder: Path, ready_file: Path) -> None:
    ending = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ending.set())
    if Path("/proc/sys/net/ipv4/ip_forward").read_text().strip() != "1":
        raise NetError("net.ipv4.ip_forward is off; expected the sysctl of compose.yaml")
    nodes = parse_nodes(os.environ.get("NODES", ""))
    links = parse_links(os.environ.get("LINKS", ""), list(nodes))
    ports = read_ports(nodes)
    for port in ports:
        turn_off_offloads(port)
    route_by_hops(ports, links)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NetError(f"--captures {folder}: {error.strerror}") from error
    running = [Capture(port, folder) for port in ports]
    try:
        for capture in running:
            capture.wait_until_listening()
        ready_file.touch()
        typer.echo(f"net: capturing towards {', '.join(port.node for port in ports)}")
        while not ending.wait(WATCH_S):
            ended = [capture for capture in running if capture.has_ended()]
            if ended:
                raise NetError(f"capture towards {ended[0].port.node} ended: {ended[0].said.strip()}")
    finally:
        write_counts(stop_all(running), folder / "captures.json")


if __name__ == "__main__":
    sys.exit(app())
