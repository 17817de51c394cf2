"""`mqttxt gs`: a ground station at the command line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.address import BrokerAddress, address_of
from ..core.settings import CONNECT_S
from ..errors import ConfigurationError
from ..protocol.commands import BROADCASTABLE, COMMANDS, Command
from ..protocol.names import check_prefix, check_root
from ..protocol.topics import SELECTABLE
from .advice import GroundStationCommands, connect, follow, not_there
from .common import errors_as_lines, named, run_coroutine, set_up_logging, settings
from .station import IDENTITY, Cloud, FogNumbers, Prefix, StationOptions, of_a_station

if TYPE_CHECKING:
    from ..station.heard import SentCommand
    from ..station.outcomes import Outcome, Outcomes

PARAMETERS = (
    "takeoff: [ALTITUDE], 10 m without; goto: LATITUDE LONGITUDE ALTITUDE (metres above home); "
    "offboard: SECONDS velocity NORTH EAST DOWN [YAW], or SECONDS attitude ROLL PITCH YAW THRUST; "
    "stream: STATE HERTZ; upload_plan: HASH; start_mission, set_current_item: HASH ITEM; resume: HASH; "
    "set_parameter: NAME VALUE; "
    "mavlink: MAV_CMD (number or name) and up to seven parameters, - or nan for one that is not set."
)
"""The parameters of each command."""

gs_app = typer.Typer(
    help="A ground station: watch drones, send commands.",
    cls=GroundStationCommands,
    no_args_is_help=True,
    rich_markup_mode=None,
)

Qos = Annotated[int, typer.Option(help="QoS of commands: 0 or 1.")]
Json = Annotated[bool, typer.Option("--json", help="Payloads in JSON instead of CBOR.")]


@gs_app.command()
@of_a_station
def watch(
    options: StationOptions,
    fog: FogNumbers,
    json: Json = False,
    bundles: Annotated[
        bool, typer.Option("--bundles", help="Ask for states together, once a second, and a broadcast's words.")
    ] = False,
) -> None:
    """Show fogs, drones, their states and how old those are at the most, until Ctrl-C."""
    from rich.console import Console

    from .watch import watch_fogs

    set_up_logging(verbose=False)

    async def job() -> int:
        fogs = options.fogs_of(fog)
        async with options.joined(fogs, settings(1, json, bundles), control=False) as station:
            await watch_fogs(station, await connect(station, fogs, options.timeout), Console())
        return 0

    run_coroutine(job())


@gs_app.command()
def share_list(
    cloud: Cloud,
    identity: Annotated[Path, IDENTITY],
    prefix: Prefix = "",
    timeout: Annotated[float, typer.Option(help="Seconds to wait for the broker's answer.")] = CONNECT_S,
) -> None:
    """Publish the identity's revocation list at the cloud broker, from where all nodes have it."""
    set_up_logging(verbose=False)

    async def job() -> int:
        options = StationOptions(cloud, str(identity), timeout=timeout)
        async with options.station(check_prefix(prefix).removesuffix("/"), control=False) as station:
            number = await station.share_list(timeout)
        typer.echo(f"{cloud} has revocation list {number}")
        return 0

    run_coroutine(job())


@gs_app.command(context_settings={"ignore_unknown_options": True})  # a negative number is a parameter
@of_a_station
def send(
    options: StationOptions,
    command: Annotated[str, typer.Argument(help=f"One of {', '.join(COMMANDS)}.")],
    parameters: Annotated[
        list[str] | None,
        typer.Argument(help=PARAMETERS),
    ] = None,
    fog: Annotated[
        list[str] | None,
        typer.Option(help="The fog's number, or FLEET/NUMBER, as acme/1; 1 by default; several only with --best."),
    ] = None,
    drones: Annotated[
        list[str] | None,
        typer.Option("--drone", help="The drone's number, or FLEET/NUMBER, as acme/1; without it the whole fog."),
    ] = None,
    best: Annotated[bool, typer.Option("--best", help="To the drone that arrives first (PSMI).")] = False,
    take_over: Annotated[bool, typer.Option("--take-over", help="Take control, if another station has it.")] = False,
    ttl: Annotated[float, typer.Option(help="Seconds within which it must start (at most 60).")] = 5.0,
    limit: Annotated[float | None, typer.Option(help="Seconds within which it must end.")] = None,
    qos: Qos = 1,
    json: Json = False,
) -> None:
    """Send a command and print each outcome as it comes; exit code 0 only if every drone completed it."""
    set_up_logging(verbose=False)

    async def job() -> int:
        from .parameters import check_times, parse_command, refuse_options

        refuse_options([command, *(parameters or [])])
        wanted = parse_command(command, parameters or [])
        check_times(ttl, limit)
        names, number = fog or ["1"], None
        if drones is not None and len(drones) > 1:
            raise ConfigurationError(f"--drone {' '.join(drones)}: expected one, or none for the whole fog")
        drone = drones[0] if drones else None
        _check_target(wanted, names, drone, best)
        places = options.fogs_of(names)
        if drone is not None:
            fleet, place, number = options.place_of(drone, names[0])
            places = {fleet: [place]}
        wants: bool | tuple[int] = True if number is None else (number,)
        async with options.joined(places, settings(qos, json), wants) as station:
            fogs = await connect(station, places, options.timeout)
            if take_over:
                for there in fogs:
                    await (there if number is None else there.drone(number)).take_over(timeout_s=options.timeout)
            sent: SentCommand[Outcome, Any] | SentCommand[Outcomes, Any]
            if best:
                sent = station.best(wanted, ttl_s=ttl, limit_s=limit)
            elif number is None:
                sent = fogs[0].broadcast(wanted, ttl_s=ttl, limit_s=limit)
            else:
                sent = fogs[0].drone(number).send(wanted, ttl_s=ttl, limit_s=limit)
            await follow(sent)
            answer = await sent
            unknown = None if number is None else not_there(fogs[0], number)
        if answer == ():
            typer.echo(f"fog {names[0]}: no drones", err=True)
        if unknown is not None:
            typer.echo(unknown, err=True)
        return 0 if answer.completed else 1

    run_coroutine(job())


@gs_app.command()
@of_a_station
def mavlink(
    options: StationOptions,
    fog: FogNumbers,
    to: Annotated[
        list[str] | None,
        typer.Option(help="udp:HOST:PORT where a MAVLink client listens, as udp:127.0.0.1:14550; several times."),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(help="tcp:HOST:PORT where MAVLink clients connect, as tcp:127.0.0.1:5760; several times."),
    ] = None,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="A client that commands takes control, whoever has it.")
    ] = False,
    insecure_mavlink: Annotated[
        bool,
        typer.Option(
            "--insecure-mavlink", help="Allow clients on other machines: whoever is there commands the drones."
        ),
    ] = False,
    ttl: Annotated[float, typer.Option(help="Seconds within which a command must start (at most 60).")] = 5.0,
    qos: Qos = 1,
    json: Json = False,
) -> None:
    """Show the drones as MAVLink vehicles to QGroundControl, MAVSDK and MAVProxy, until Ctrl-C."""
    from ..gateway.endpoints import ClientAddress
    from ..gateway.process import Gateway
    from .parameters import check_times

    set_up_logging(verbose=False)

    async def job() -> int:
        targets = [ClientAddress.parse(text, "udp", "--to", insecure_mavlink) for text in to or ()]
        servers = [ClientAddress.parse(text, "tcp", "--listen", insecure_mavlink) for text in listen or ()]
        if not targets and not servers:
            raise ConfigurationError("expected --to udp:HOST:PORT or --listen tcp:HOST:PORT, or both")
        check_times(ttl)
        fogs_of = options.fogs_of(fog)
        if len(fogs_of) > 1:
            raise ConfigurationError(
                f"--fog {' '.join(fog)}: expected fogs of one fleet: MAVLink's ids are per fleet, so that each takes a "
                "gateway of its own"
            )
        (fleet,) = fogs_of
        async with options.station(fleet, settings(qos, json), control=False) as station:
            fogs = await connect(station, fogs_of, options.timeout)
            await Gateway(station, ttl, take_over).run(fogs, targets, servers)
        return 0

    run_coroutine(job())


@gs_app.command()
@of_a_station
def metrics(
    options: StationOptions,
    fog: FogNumbers,
    listen: Annotated[str, typer.Option(help="HOST:PORT where Prometheus scrapes /metrics.")] = "127.0.0.1:9464",
    json: Json = False,
) -> None:
    """Serve what is known of fogs, drones and sensors as Prometheus metrics, until Ctrl-C. Commands nothing."""
    try:
        from ..metrics import serve
    except ModuleNotFoundError:
        with errors_as_lines():
            raise ConfigurationError("metrics: expected prometheus-client: pip install 'mqttxt[metrics]'") from None
    set_up_logging(verbose=False)

    async def job() -> int:
        host, port = address_of(listen, "--listen")
        fogs = options.fogs_of(fog)
        async with options.joined(fogs, settings(1, json), control=False) as station:
            serve(await connect(station, fogs, options.timeout), host, port)
            async for _ in station.events():
                pass
        return 0

    run_coroutine(job())


@gs_app.command()
@of_a_station
def homeassistant(
    options: StationOptions,
    fog: FogNumbers,
    broker: Annotated[
        str,
        typer.Option(
            help="Home Assistant's broker: mqtt://[USER:PASSWORD@]HOST[:PORT].", envvar="MQTTXT_HOMEASSISTANT"
        ),
    ],
    discovery: Annotated[str, typer.Option(help="Home Assistant's discovery prefix.")] = "homeassistant",
    insecure_broker: Annotated[
        bool, typer.Option("--insecure-broker", help="Allow mqtt:// to a broker of Home Assistant on another machine.")
    ] = False,
    json: Json = False,
) -> None:
    """Show drones and sensors as devices of Home Assistant, by MQTT discovery, until Ctrl-C. Commands nothing."""
    from ..homeassistant import Entities, HomeAssistant

    set_up_logging(verbose=False)

    async def job() -> int:
        parsed = BrokerAddress.parse(broker, "--broker")
        if not (parsed.tls or parsed.is_loopback or insecure_broker):
            raise ConfigurationError(f"--broker {parsed}: not encrypted; expected mqtts://, or --insecure-broker")
        with named("--discovery"):
            prefix = check_root(discovery).rstrip("/")
        fogs_of = options.fogs_of(fog)
        async with options.joined(fogs_of, settings(1, json), control=False) as station:
            fogs = await connect(station, fogs_of, options.timeout)
            await HomeAssistant(parsed, Entities(fogs, prefix)).run()
        return 0

    run_coroutine(job())


def _check_target(command: Command, fogs: list[str], drone: str | None, best: bool) -> None:
    """Check the addressee of a command; raises ConfigurationError."""
    if best and drone is not None:
        raise ConfigurationError(f"--drone {drone}: expected none with --best, which chooses the drone")
    if len(fogs) > 1 and not best:
        raise ConfigurationError(f"--fog {' '.join(fogs)}: expected one, or --best")
    if best and command.name not in SELECTABLE:
        raise ConfigurationError(f"--best {command.name}: expected one of {', '.join(SELECTABLE)}")
    if drone is None and not best and not isinstance(command, BROADCASTABLE):
        chosen = ", or --best" if command.name in SELECTABLE else ""
        raise ConfigurationError(f"{command.name}: expected --drone NUMBER{chosen}: it is for one drone")
