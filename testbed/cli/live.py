"""The commands for a fleet by hand: starting and ending it, changing its links, and its live page."""

from __future__ import annotations

import asyncio
import functools
import logging
import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mqttxt.errors import MqttxtError
from net.link_plan import SHAPERS

from ..errors import TestbedError
from ..fly.containers import NODE_USER, Containers, start_network
from ..fly.flights import by_hand, settings_of
from ..fly.identities import make_identities
from ..fly.links import plan_links, start_clock, write_plan
from ..fly.live_links import Ask, changes, read_live_plan, tell
from ..fly.only_run import only_run
from ..fly.page_process import PORT, end_page, page_port, page_url, start_page
from ..fly.progress import ConsoleProgress
from ..fly.results import live_attempt
from ..plan.experiments import ARMS, PROTOCOLS, make_plan, one_protocol
from ..plan.factors import FACTORS
from ..plan.fleets import fleet_of, standard_fleet
from ..plan.machines import refuse_machines
from ..plan.overrides import fleet_in
from ..plan.typed import one_of
from ..present.reporting import RESULTS, make_console
from .machines import until_a_signal

LIVE = RESULTS / ".live"
PROFILE_HELP = "How the links are: a name of `testbed profiles`, or the path of a .yaml file."
SHAPER_HELP = f"What shapes the links: {', '.join(SHAPERS)}; auto: netem where the kernel has it."


def factor_help(name: str) -> str:
    """The help text for a factor's values."""
    return f"{', '.join(FACTORS[name])}; empty: the arm's."


def up(
    protocol: Annotated[str, typer.Option(help=f"Over what: {' or '.join(PROTOCOLS)}.")] = PROTOCOLS[0],
    arm: Annotated[str, typer.Option(help=f"How the fleet talks: {', '.join(ARMS)}.")] = "thesis",
    streams: Annotated[str, typer.Option(help=factor_help("streams"))] = "",
    qos: Annotated[str, typer.Option(help=factor_help("qos"))] = "",
    chain: Annotated[str, typer.Option(help=factor_help("chain"))] = "",
    states: Annotated[str, typer.Option(help=factor_help("states"))] = "",
    commanding: Annotated[str, typer.Option(help=factor_help("commanding"))] = "",
    security: Annotated[str, typer.Option(help=f"{', '.join(FACTORS['security'])}; empty: tls.")] = "",
    station: Annotated[str, typer.Option(help=factor_help("station"))] = "",
    tcp: Annotated[str, typer.Option(help=factor_help("tcp"))] = "",
    air: Annotated[str, typer.Option(help=factor_help("air"))] = "",
    encoding: Annotated[str, typer.Option(help="Payloads of fogs and drones: cbor, or json for people.")] = "cbor",
    profile: Annotated[str, typer.Option(help=PROFILE_HELP)] = "ideal",
    shaper: Annotated[str, typer.Option(help=SHAPER_HELP)] = SHAPERS[0],
) -> None:
    """Start the fleet and leave it running, to explore by hand."""
    factors = {"streams": streams, "commanding": commanding, "qos": qos, "chain": chain, "states": states}
    factors |= {"security": security or "tls", "station": station, "tcp": tcp, "air": air}
    refuse_machines(os.environ, "testbed up")
    fleet = fleet_of(os.environ)
    plan = make_plan("scenario-1", "1", arm, profile, one_protocol(protocol), factors, shaper, fleet=fleet)
    settings = settings_of(plan, protocol, encoding)
    only_run()
    end_page(LIVE)
    plan = replace(plan, page=page_port())
    attempt = live_attempt(LIVE, protocol)
    write_plan(attempt.path / "links", plan_links(plan, 1), plan.topology, plan.shaper, always=True)
    containers = Containers(protocol, LIVE, settings, fleet)
    with ConsoleProgress(make_console()).phase(f"starting {containers.count} containers"):
        containers.down()
        if plan.is_secured(protocol):
            start_network(containers, [node.name for node in plan.topology.nodes])
            make_identities(containers, plan)
        containers.start()
    start_clock(attempt.path / "links")
    try:
        start_page(plan, attempt, watch_only=protocol == "mavlink")
        typer.echo(f"the page: {page_url(plan.page or PORT)}")
    except TestbedError as error:  # the fleet is up and can be flown from the terminal
        typer.echo(f"testbed: {error}", err=True)
    typer.echo(by_hand(plan, protocol, containers.name_of))


def link(
    name: Annotated[str, typer.Argument(help="The link, as air:uav3; air:uav3:up for one direction of it.")],
    rate: Annotated[str, typer.Option(help="Bits a second, as 1Mbit, or unlimited.")] = "",
    queue: Annotated[str, typer.Option(help="Frames that wait for the rate, as '100 packets'.")] = "",
    delay: Annotated[str, typer.Option(help="As 200ms.")] = "",
    jitter: Annotated[str, typer.Option(help="As 20ms.")] = "",
    loss: Annotated[str, typer.Option(help="As 20%.")] = "",
    duplicate: Annotated[str, typer.Option(help="As 1%.")] = "",
    corrupt: Annotated[str, typer.Option(help="As 1%.")] = "",
    reorder: Annotated[str, typer.Option(help="As 1%.")] = "",
    closed: Annotated[bool, typer.Option("--closed", help="Let nothing through.")] = False,
    back: Annotated[bool, typer.Option("--back", help="As its profile says again.")] = False,
) -> None:
    """Change a link of the fleet that is up; what is not named is as its profile says."""
    given = {
        "rate": rate,
        "queue": queue,
        "delay": delay,
        "jitter": jitter,
        "loss": loss,
        "duplicate": duplicate,
        "corrupt": corrupt,
        "reorder": reorder,
    }
    typed = {option: value for option, value in given.items() if value}
    fleet = fleet_in(LIVE)
    containers = Containers(PROTOCOLS[0], LIVE, {}, fleet)
    ask = functools.partial(containers.output, "net", user="0:0")
    for change in changes(read_live_plan(ask), fleet.topology(), name, typed, closed=closed, back=back):
        tell(ask, change)
        said = [f"{option} {value}" for option, value in typed.items()] + (["closed"] if closed else [])
        typer.echo(f"{change.link}: {', '.join(said) or 'as planned'}")


def page(
    folder: Annotated[Path, typer.Argument(help="The run's folder: results/.live of `make up`.")],
    protocol: Annotated[str, typer.Option(help=f"Over what: {' or '.join(PROTOCOLS)}.")] = PROTOCOLS[0],
    security: Annotated[str, typer.Option(help=f"Of the fleet: {', '.join(FACTORS['security'])}.")] = "none",
    port: Annotated[int, typer.Option(help="Where the page listens, on this machine alone.")] = PORT,
    watch_only: Annotated[bool, typer.Option("--watch-only", help="Take no control, and command nothing.")] = False,
) -> None:
    """Serve the live page of the fleet that is up, until Ctrl-C; `make up` and PAGE=1 start it."""
    from ..fly.page import serve_page  # with aiohttp, which no other command needs

    one_protocol(protocol)
    one_of("--security", security, FACTORS["security"])
    logging.basicConfig(level=logging.INFO)
    fleet = fleet_in(folder)
    containers = Containers(protocol, folder, {}, fleet)

    def asks(service: str) -> Ask:
        return functools.partial(containers.output, service, user="0:0" if service == "net" else NODE_USER)

    try:
        asyncio.run(until_a_signal(serve_page(protocol, folder, fleet, asks, security, port, watch_only)))
    except MqttxtError as error:
        raise TestbedError(str(error)) from error


def down() -> None:
    """End what `up` started, over whatever protocol and with whatever fleet."""
    end_page(LIVE)
    with ConsoleProgress(make_console()).phase("ending the containers"):
        Containers(PROTOCOLS[0], LIVE, {}, standard_fleet()).down()
