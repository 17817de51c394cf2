"""The commands of `net`: `route` runs the container, `shape` its emulator, `change` changes a link by hand, `probe`
measures the links of a node.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from .emulator.control import Channel
from .emulator.plan import PlanError, read_plan
from .emulator.process import shape as shape_links
from .hops import parse_links
from .interfaces import NetError, parse_nodes, read_ports, turn_off_offloads
from .probe import main as send_probes
from .routing import route as route_frames
from .shaping.server import SOCKET, ask

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.callback()
def about() -> None:
    """The testbed's network."""


@contextmanager
def _one_line() -> Iterator[None]:
    """Turn an error into one line: exit code 2 for a wrong plan, 1 for any other, as of the machine."""
    try:
        yield
    except NetError as error:
        typer.echo(f"net: {error}", err=True)
        raise typer.Exit(2 if isinstance(error, PlanError) else 1) from None


@app.command()
def route(
    captures: Annotated[Path, typer.Option(help="Folder for one pcap a node and captures.json.")],
    ready_file: Annotated[Path, typer.Option(help="File that is made once everything is shaped and captured.")],
    links: Annotated[Path, typer.Option(help="Folder with the links' plan.json.")],
    control: Annotated[Path, typer.Option(help="Socket for changes by hand.")] = SOCKET,
) -> None:
    """Route between all nodes, hop by hop, shape every link and capture at each node, until SIGTERM or SIGINT."""
    with _one_line():
        route_frames(captures, links, control, ready_file)


@app.command()
def shape(
    plan: Annotated[Path, typer.Option(help="The links' plan, JSON.")],
    counters: Annotated[Path, typer.Option(help="File for what each link did, written each second and at the end.")],
    ready_file: Annotated[Path | None, typer.Option(help="File that is made once every link is shaped.")] = None,
    channel: Annotated[
        int | None, typer.Option(help="Descriptor of `net route`'s socket, which then gives orders.")
    ] = None,
) -> None:
    """Shape every link as planned, on NFQUEUE, until SIGTERM or SIGINT."""
    with _one_line():
        planned = read_plan(plan)
        nodes = parse_nodes(os.environ.get("NODES", ""))
        links = parse_links(os.environ.get("LINKS", ""), list(nodes))
        ports = read_ports(nodes)
        for port in ports:
            turn_off_offloads(port)
        said = ready_file if channel is None else Channel.of_descriptor(channel)
        shape_links(planned, ports, links, counters, said)


@app.command()
def probe(
    schedule: Annotated[
        str, typer.Argument(help="What to send and how long to receive, JSON; empty: from stdin.")
    ] = "",
) -> None:
    """Send and receive datagrams on a node by a schedule, with the kernel's times, and print what came as JSON."""
    raise typer.Exit(send_probes([schedule] if schedule else []))


@app.command()
def change(
    link: Annotated[str, typer.Argument(help="A directed link, as air:uav3:up; or a whole request in JSON.")],
    fields: Annotated[
        list[str] | None, typer.Argument(help="FIELD=VALUE of the plan, as loss=0.2; none: back.")
    ] = None,
    kernel: Annotated[str, typer.Option(help="The kernel's commands for it, where netem shapes: JSON.")] = "[]",
    control: Annotated[Path, typer.Option(help="The socket of `net route`.")] = SOCKET,
) -> None:
    """Change a link while everything goes on; without a field it is back as planned. Prints the answer, in JSON."""
    with _one_line():
        if link.startswith("{"):
            request = _parsed(link, "the request")
        else:
            found = dict(_field(text) for text in fields or ())
            request = {"link": link, "change": found or None, "kernel": _parsed(kernel, "--kernel")}
        answer = ask(control, request)
    typer.echo(json.dumps(answer))
    if "error" in answer:
        raise typer.Exit(1)


def _field(text: str) -> tuple[str, Any]:
    name, sign, value = text.partition("=")
    if not sign or not name:
        raise PlanError(f"{text!r}: expected FIELD=VALUE, as loss=0.2")
    return name, value if value.isalpha() and value not in ("true", "false", "null") else _parsed(value, name)


def _parsed(text: str, where: str) -> Any:
    try:
        return json.loads(text)
    except ValueError as error:
        raise PlanError(f"{where} {text!r}: expected JSON") from error


if __name__ == "__main__":
    sys.exit(app())
