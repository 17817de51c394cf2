"""`mqttxt conformance`: checks an implementation of a role against the rules of the specification."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.address import BrokerAddress
from ..core.clock import MAX_TTL_MS
from ..errors import ConfigurationError
from ..protocol.topics import MAX_DRONE, check_number, check_prefix
from .common import run_coroutine

if TYPE_CHECKING:
    from mqttxt_conformance.registry import Finding

conformance_app = typer.Typer(
    help="Check an implementation of a role against the specification's rules.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Checking = Callable[[Callable[["Finding"], None]], Coroutine[Any, Any, list["Finding"]]]

Format = Annotated[str, typer.Option("--format", help="table or json.")]
Run = Annotated[
    str | None,
    typer.Option(help="Command line that starts the implementation; without it, it is expected to run already."),
]
LogFile = Annotated[Path | None, typer.Option("--log", help="File for what the started implementation prints.")]
FogRoot = Annotated[str, typer.Option(help="Root of the fog side's topics, as fog1/local/.")]


@conformance_app.command()
def uav(
    broker: Annotated[str, typer.Option(help="The fog's broker: mqtt://HOST[:PORT].")],
    drone: Annotated[int, typer.Option(help="The drone's number.")] = 1,
    autopilot: Annotated[
        str, typer.Option(help="udp:HOST:PORT where the UAV client listens for its autopilot.")
    ] = "udp:127.0.0.1:14540",
    fog_root: FogRoot = "",
    run: Run = None,
    log: LogFile = None,
    format_: Format = "table",
) -> None:
    """Check a UAV client: the kit plays its activator and its autopilot.

    {broker}, {drone} and {autopilot} in --run are replaced.
    """
    from mqttxt_conformance.uav import UavTarget, check_uav

    from ..drone.mavlink.link import AutopilotAddress

    async def job() -> int:
        where = AutopilotAddress.parse(autopilot)
        if where.kind != "udp":
            raise ConfigurationError(f"--autopilot {autopilot!r}: expected udp:HOST:PORT")
        number, root = check_number("--drone", drone, MAX_DRONE), check_prefix(fog_root)
        target = UavTarget(number, where.host, where.port, root, run, log)
        address = BrokerAddress.parse(broker, "--broker")
        return await _report("uav", format_, partial(check_uav, address, target))

    run_coroutine(job())


@conformance_app.command()
def activator(
    broker: Annotated[str, typer.Option(help="The cloud broker: mqtt://HOST[:PORT].")],
    fog_broker: Annotated[str, typer.Option(help="The fog's broker: mqtt://HOST[:PORT].")],
    fog: Annotated[int, typer.Option(help="The fog's number.")] = 1,
    prefix: Annotated[str, typer.Option(help="Prefix of every topic at the cloud broker, as acme/.")] = "",
    fog_root: FogRoot = "",
    run: Run = None,
    log: LogFile = None,
    format_: Format = "table",
) -> None:
    """Check an activator: the kit plays its ground stations and its drones 1 and 2, on both brokers.

    {broker}, {fog_broker}, {fog}, {drones} and {fog_root} in --run are replaced.
    """
    from mqttxt_conformance.activator import ActivatorTarget, check_activator

    async def job() -> int:
        number, root = check_number("--fog", fog), check_prefix(fog_root)
        target = ActivatorTarget(number, check_prefix(prefix), root, run, log)
        cloud_address = BrokerAddress.parse(broker, "--broker")
        fog_address = BrokerAddress.parse(fog_broker, "--fog-broker")
        return await _report(
            "activator", format_, lambda tell: check_activator(cloud_address, fog_address, target, tell)
        )

    run_coroutine(job())


@conformance_app.command()
def gs(
    broker: Annotated[str, typer.Option(help="The cloud broker: mqtt://HOST[:PORT].")],
    fog: Annotated[int, typer.Option(help="The fog's number, which no activator serves now.")] = 1,
    drone: Annotated[int, typer.Option(help="The number of the drone that gets the commands.")] = 1,
    prefix: Annotated[str, typer.Option(help="Prefix of every topic at the cloud broker, as acme/.")] = "",
    ttl: Annotated[float, typer.Option(help="Seconds that the station gives its commands to start.")] = 5.0,
    run: Run = None,
    log: LogFile = None,
    format_: Format = "table",
) -> None:
    """Check a ground station: the kit plays a fog's activator and its drone.

    Let the station register at the fog and send at least two commands to the drone, one after another. {broker}, {fog}
    and {drone} in --run are replaced.
    """
    from mqttxt_conformance.gs import GsTarget, check_gs

    async def job() -> int:
        numbers = check_number("--fog", fog), check_number("--drone", drone, MAX_DRONE)
        if not 0 < ttl <= MAX_TTL_MS / 1000:
            raise ConfigurationError(f"--ttl {ttl:g}: expected more than 0 and at most {MAX_TTL_MS // 1000} s")
        target = GsTarget(*numbers, check_prefix(prefix), ttl, run, log)
        address = BrokerAddress.parse(broker, "--broker")
        if run is None:
            typer.echo(f"now let the ground station at {address} command drone {drone} of fog {fog}", err=True)
        return await _report("ground station", format_, partial(check_gs, address, target))

    run_coroutine(job())


async def _report(role: str, format_: str, check: Checking) -> int:
    """Check, print, and say by the exit code whether a rule failed."""
    from rich.console import Console

    from mqttxt_conformance.registry import Verdict
    from mqttxt_conformance.report import as_json, count, print_table

    if format_ not in ("table", "json"):
        raise ConfigurationError(f"--format {format_!r}: expected table or json")
    progress = Console(stderr=True)

    def tell(finding: Finding) -> None:
        progress.print(f"{finding.rule.name}: {finding.verdict.value}", highlight=False)

    findings = await check(tell)
    if format_ == "json":
        typer.echo(as_json(role, findings))
    else:
        console = Console()
        print_table(role, findings, console if console.is_terminal else Console(width=140))
    return 1 if count(findings, Verdict.FAIL) else 0
