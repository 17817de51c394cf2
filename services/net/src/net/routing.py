"""The work of `net route`: sets up routes, captures and shaped links, and watches them until the end."""

from __future__ import annotations

import os
import selectors
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from socket import socket

import typer

from .captures import Capture, stop_all, write_counts
from .emulator.plan import PlanError
from .ending import Ending
from .hops import parse_links, route_by_hops
from .interfaces import NetError, Port, check_rights, parse_nodes, read_ports, turn_off_offloads
from .shaping.attend import Attendant
from .shaping.choice import ShaperChoice, choose
from .shaping.emulated import EmulatedLinks
from .shaping.journal import Journal
from .shaping.kernel import KernelLinks
from .shaping.run_plan import RunPlan, read_run_plan

WATCH_S = 1.0


def route(captures: Path, links: Path, control: Path, ready_file: Path) -> None:
    """Route until SIGTERM or SIGINT. Raises NetError, or PlanError if the plan of the links cannot be carried out."""
    run = read_run_plan(links / "plan.json")
    check_rights()
    if Path("/proc/sys/net/ipv4/ip_forward").read_text().strip() != "1":
        raise NetError("net.ipv4.ip_forward is off; expected the sysctl of compose.yaml")
    nodes = parse_nodes(os.environ.get("NODES", ""))
    pairs = parse_links(os.environ.get("LINKS", ""), list(nodes))
    ports = read_ports(nodes)
    for port in ports:
        turn_off_offloads(port)
    route_by_hops(ports, pairs)
    with Ending() as ending, ExitStack() as stack:
        watched: dict[socket, Callable[[], None]] = {ending.wake: ending.drain}
        choice = choose(run)
        attendant = Attendant(links, run, choice, _maker(choice, links, run, ports))
        stack.callback(attendant.end)
        watched |= attendant.serve(control)
        running = _capture(ports, captures)
        stack.callback(lambda: write_counts(stop_all(running), captures / "captures.json"))
        for capture in running:
            capture.wait_until_listening()
        ready_file.touch()
        typer.echo(f"net: capturing towards {', '.join(port.node for port in ports)}")
        _watch(ending, watched, running, attendant)


def _maker(
    choice: ShaperChoice, folder: Path, run: RunPlan, ports: Sequence[Port]
) -> Callable[[Journal], KernelLinks | EmulatedLinks | None]:
    def make(journal: Journal) -> KernelLinks | EmulatedLinks | None:
        if choice.shaper == "none":
            return None
        if choice.shaper == "netem":
            return KernelLinks(folder, run, ports, journal)
        try:
            return EmulatedLinks(folder, journal)
        except PlanError:
            raise
        except NetError as error:
            raise NetError(f"no shaper: {choice.why}; by NFQUEUE: {error}") from error

    return make


def _capture(ports: Sequence[Port], folder: Path) -> list[Capture]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NetError(f"--captures {folder}: {error.strerror}") from error
    return [Capture(port, folder) for port in ports]


def _watch(
    ending: Ending,
    watched: dict[socket, Callable[[], None]],
    running: Sequence[Capture],
    attendant: Attendant,
) -> None:
    watch_s = time.monotonic()
    with selectors.DefaultSelector() as selector:
        for source, act in watched.items():
            selector.register(source, selectors.EVENT_READ, act)
        while not ending.has_come():
            wait_s = attendant.attend()
            if time.monotonic() >= watch_s:
                watch_s = time.monotonic() + WATCH_S
                for capture in running:
                    if capture.has_ended():
                        raise NetError(f"capture towards {capture.port.node} ended: {capture.said.strip()}")
            for key, _ in selector.select(wait_s):
                key.data()
