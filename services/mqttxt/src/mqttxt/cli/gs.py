"""`mqttxt gs`: a ground station at the command line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import ConfigurationError
from ..protocol.commands import BROADCASTABLE, COMMANDS, Command
from ..protocol.topics import MAX_DRONE, SELECTABLE, check_number
from .common import run_coroutine, set_up_logging, settings
from .parameters import HELP, parse_command

if TYPE_CHECKING:
    from ..station.heard import SentCommand
    from ..station.outcomes import Outcome, Outcomes

gs_app = typer.Typer(help="A ground station: watch drones, send commands.", no_args_is_help=True, rich_markup_mode=None)

Cloud = Annotated[str, typer.Option(help="The cloud broker: mqtt://HOST[:PORT].", envvar="MQTTXT_CLOUD")]
Qos = Annotated[int, typer.Option(help="QoS of commands: 0 or 1.")]
Json = Annotated[bool, typer.Option("--json", help="Payloads in JSON instead of CBOR.")]
Prefix = Annotated[str, typer.Option(help="Prefix of every topic, as acme/.")]
Identity = Annotated[
    Path | None,
    typer.Option(
        help="The folder of the station's identity, for mqtts:// (`mqttxt keys issue`).", envvar="MQTTXT_IDENTITY"
    ),
]
Signed = Annotated[
    bool,
    typer.Option(
        "--signed",
        help="Sign, and hear only what is signed; takes --identity. The whole fleet, or none of it.",
        envvar="MQTTXT_SIGNED",
    ),
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure",
        help="Allow mqtt:// to other machines: whoever is there commands the drones.",
        envvar="MQTTXT_INSECURE",
    ),
]
Timeout = Annotated[float, typer.Option(help="Seconds to wait for the fog's activator.")]


@gs_app.command()
def watch(
    fog: Annotated[list[int], typer.Option(help="A fog's number; may be given several times.")],
    cloud: Cloud = "mqtt://127.0.0.1:1883",
    identity: Identity = None,
    signed: Signed = False,
    insecure: Insecure = False,
    prefix: Prefix = "",
    json: Json = False,
    bundles: Annotated[bool, typer.Option("--bundles", help="Ask for states together, once a second.")] = False,
    timeout: Timeout = 10.0,
) -> None:
    """Show fogs, drones, their states and how old those are at the most, until Ctrl-C."""
    from rich.console import Console

    from ..station.ground_station import GroundStation
    from .watch import watch_fogs

    set_up_logging(verbose=False)

    async def job() -> int:
        chosen = settings(1, json)
        station_options: dict[str, Any] = {"encoding": chosen.encoding, "control": False, "bundles": bundles}
        station_options |= {"identity": identity, "signed": signed, "insecure": insecure}
        async with GroundStation(cloud, prefix=prefix, **station_options) as station:
            await watch_fogs(station, await station.connect(fog, timeout), Console())
        return 0

    run_coroutine(job())


@gs_app.command(context_settings={"ignore_unknown_options": True})  # a negative number is a parameter
def send(
    command: Annotated[str, typer.Argument(help=f"One of {', '.join(COMMANDS)}.")],
    parameters: Annotated[
        list[str] | None,
        typer.Argument(help=HELP),
    ] = None,
    fog: Annotated[
        list[int] | None, typer.Option(help="The fog's number, 1 by default; several only with --best.")
    ] = None,
    drone: Annotated[int | None, typer.Option(help="The drone's number; without it the whole fog.")] = None,
    best: Annotated[bool, typer.Option("--best", help="To the drone that arrives first (PSMI).")] = False,
    take_over: Annotated[bool, typer.Option("--take-over", help="Take control, if another station has it.")] = False,
    cloud: Cloud = "mqtt://127.0.0.1:1883",
    identity: Identity = None,
    signed: Signed = False,
    insecure: Insecure = False,
    ttl: Annotated[float, typer.Option(help="Seconds within which it must start (at most 60).")] = 5.0,
    limit: Annotated[float | None, typer.Option(help="Seconds within which it must end.")] = None,
    qos: Qos = 1,
    json: Json = False,
    prefix: Prefix = "",
    timeout: Timeout = 10.0,
) -> None:
    """Send a command and print each outcome as it comes; exit code 0 only if every drone completed it."""
    from ..station.ground_station import GroundStation

    set_up_logging(verbose=False)

    async def job() -> int:
        wanted = parse_command(command, parameters or [])
        numbers = fog or [1]
        _check_target(wanted, numbers, drone, best)
        chosen = settings(qos, json)
        how: dict[str, Any] = {"qos": chosen.qos, "encoding": chosen.encoding, "prefix": prefix}
        how |= {"identity": identity, "signed": signed, "insecure": insecure}
        async with GroundStation(cloud, **how) as station:
            fogs = await station.connect(numbers, timeout)
            if take_over:
                for there in fogs:
                    await (there.take_over(timeout) if drone is None else there.drone(drone).take_over(timeout))
            sent: SentCommand[Outcome, Any] | SentCommand[Outcomes, Any]
            if best:
                sent = station.best(wanted, numbers, ttl_s=ttl, limit_s=limit)
            elif drone is None:
                sent = fogs[0].broadcast(wanted, ttl_s=ttl, limit_s=limit)
            else:
                sent = fogs[0].drone(drone).send(wanted, ttl_s=ttl, limit_s=limit)
            async for said in sent:
                typer.echo(str(said))
            answer = await sent
        if answer == ():
            typer.echo(f"fog {numbers[0]}: no drones", err=True)
        return 0 if answer.completed else 1

    run_coroutine(job())


def _check_target(command: Command, fogs: list[int], drone: int | None, best: bool) -> None:
    """Whom a command may go to; raises ConfigurationError."""
    if best and drone is not None:
        raise ConfigurationError(f"--drone {drone}: expected none with --best, which chooses the drone")
    if len(fogs) > 1 and not best:
        raise ConfigurationError(f"--fog {' '.join(map(str, fogs))}: expected one, or --best")
    if best and command.name not in SELECTABLE:
        raise ConfigurationError(f"--best {command.name}: expected one of {', '.join(SELECTABLE)}")
    if drone is None and not best and not isinstance(command, BROADCASTABLE):
        raise ConfigurationError(f"{command.name}: expected --drone, because each drone has its own")
    if drone is not None:
        check_number("--drone", drone, MAX_DRONE)
