"""`mqttxt conformance`: checks an implementation of a role against the rules of the specification."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..core.address import BrokerAddress, address_of
from ..errors import ConfigurationError
from ..protocol.names import MAX_DRONE, check_number, check_prefix, check_root
from .common import run_coroutine
from .node_options import autopilot_address

if TYPE_CHECKING:
    from mqttxt_conformance.registry import Finding
    from mqttxt_conformance.sealed import Folder

    from ..security.identity import Identity

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
Fleet = Annotated[
    Path | None,
    typer.Option(help="A fleet's folder of `mqttxt keys`, for mqtts://: the kit has the identities of its parts."),
]
Signed = Annotated[bool, typer.Option("--signed", help="Messages are signed; takes --fleet.")]
SignedReadings = Annotated[
    bool,
    typer.Option(
        "--signed-readings",
        help="The implementation hears only readings that sensors signed; takes --signed, and the fleet's sensor 4.",
    ),
]
Nodes = Annotated[
    list[str], typer.Argument(help="The broker: mqtt://HOST[:PORT]; of a cluster each node's.", metavar="URL...")
]
Side = Annotated[
    str, typer.Option(help="Which broker it is to be: cloud, fog (the activator's) or drone (its own, for sensors).")
]
FogRoot = Annotated[str, typer.Option(help="Root of the fog side's topics, as fog1/local/.")]


@conformance_app.command()
def uav(
    broker: Annotated[
        str,
        typer.Option(
            help="The fog's broker: mqtt://HOST[:PORT]; or where the kit is a gateway: mqtt-sn://HOST[:PORT]."
        ),
    ],
    second_broker: Annotated[
        str | None, typer.Option(help="Another broker of the fog, on this machine: the client has two connections.")
    ] = None,
    drone: Annotated[int, typer.Option(help="The drone's number.")] = 1,
    autopilot: Annotated[
        str, typer.Option(help="udp:HOST:PORT where the UAV client listens for its autopilot.")
    ] = "udp:127.0.0.1:14540",
    fog_root: FogRoot = "",
    fleet: Fleet = None,
    signed: Signed = False,
    fog: Annotated[int, typer.Option(help="With --fleet: the number of the fog whose activator the kit plays.")] = 1,
    run: Run = None,
    log: LogFile = None,
    format_: Format = "table",
) -> None:
    """Check a UAV client: the kit plays its activator and its autopilot.

    {broker}, {drone} and {autopilot} in --run are replaced, and the names of files {audit} and {mavlink_key}; with
    --fleet also {identity} and {fog}, and with --second-broker {second_broker}: both are then the kit's links, which it
    cuts under the client. With mqtt-sn:// it
    is checked by the rules of section 20 alone. The fleet has a station `ops` that may command the drone, and a station
    `guest` that may only observe.
    """
    from mqttxt_conformance.uav import UavTarget, check_uav
    from mqttxt_conformance.uav_air import check_uav_air

    async def job() -> int:
        where = autopilot_address(autopilot)
        if where.kind != "udp":
            raise ConfigurationError(f"--autopilot {autopilot!r}: expected udp:HOST:PORT")
        number, root = check_number("--drone", drone, MAX_DRONE), check_root(fog_root)
        address = BrokerAddress.parse(broker, "--broker", datagrams=True)
        if address.datagrams and (fleet or signed or second_broker):
            raise ConfigurationError(
                f"--broker {address}: expected neither --fleet, --signed nor --second-broker beside it"
            )
        folder = _folder(fleet, signed, address)
        second = _second(second_broker, address)
        of_fog = check_number("--fog", fog)
        target = UavTarget(number, where.host, where.port, root, run, log, folder, of_fog, second)
        check = check_uav_air if address.datagrams else check_uav
        return await _report("uav", format_, partial(check, address, target))

    run_coroutine(job())


@conformance_app.command()
def activator(
    broker: Annotated[str, typer.Option(help="The cloud broker: mqtt://HOST[:PORT].")],
    fog_broker: Annotated[str, typer.Option(help="The fog's broker: mqtt://HOST[:PORT].")],
    second_fog_broker: Annotated[
        str | None, typer.Option(help="Another broker of the fog: the activator is connected to both.")
    ] = None,
    air_sn: Annotated[
        str | None, typer.Option("--air-sn", help="HOST:PORT where the activator's gateway listens for datagrams.")
    ] = None,
    fog: Annotated[int, typer.Option(help="The fog's number.")] = 1,
    prefix: Annotated[str, typer.Option(help="Prefix of every topic at the cloud broker, as acme/.")] = "",
    fog_root: FogRoot = "",
    fleet: Fleet = None,
    signed: Signed = False,
    signed_readings: SignedReadings = False,
    run: Run = None,
    log: LogFile = None,
    format_: Format = "table",
) -> None:
    """Check an activator: the kit plays its ground stations and its drones 1 and 2, on both brokers.

    {broker}, {fog_broker}, {fog}, {drones} and {fog_root} in --run are replaced, and the name of a file {audit}; with
    --fleet also {identity}. With --second-fog-broker, {second_fog_broker} in --run, it is checked by the rules of
    section 19 alone, with --air-sn, {air_sn} in --run, by those of section 20. With --fleet and --signed it is checked
    by the rules of section 12, without them by all others.
    """
    from mqttxt_conformance.activator import ActivatorTarget, check_activator
    from mqttxt_conformance.activator_air import check_activator_air

    async def job() -> int:
        number, root = check_number("--fog", fog), check_root(fog_root)
        cloud_address = BrokerAddress.parse(broker, "--broker")
        folder = _folder(fleet, signed, cloud_address, signed_readings)
        if folder is not None and not folder.signed:
            raise ConfigurationError(f"--fleet {fleet}: expected --signed beside it")
        fog_address = BrokerAddress.parse(fog_broker, "--fog-broker")
        second = BrokerAddress.parse(second_fog_broker, "--second-fog-broker") if second_fog_broker else None
        if second is not None and (folder is not None or second == fog_address):
            raise ConfigurationError(f"--second-fog-broker {second}: expected another broker, and no --fleet beside it")
        target = ActivatorTarget(number, check_prefix(prefix), root, run, log, folder, second)
        if air_sn is not None:
            if folder is not None or second is not None:
                raise ConfigurationError(
                    f"--air-sn {air_sn}: expected neither --fleet nor --second-fog-broker beside it"
                )
            gateway = address_of(air_sn, "--air-sn")
            check = partial(check_activator_air, cloud_address, fog_address, gateway, target)
            return await _report("activator", format_, check)
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
    fleet: Fleet = None,
    signed: Signed = False,
    signed_readings: SignedReadings = False,
    run: Run = None,
    log: LogFile = None,
    format_: Format = "table",
) -> None:
    """Check a ground station: the kit plays a fog's activator and its drone.

    Let the station register at the fog and send at least two commands to the drone, one after another. {broker}, {fog}
    and {drone} in --run are replaced; with --fleet also {identity}, that of the fleet's station `ops`.
    """
    from mqttxt_conformance.gs import GsTarget, check_gs

    from .parameters import check_times

    async def job() -> int:
        fog_number, drone_number = check_number("--fog", fog), check_number("--drone", drone, MAX_DRONE)
        check_times(ttl)
        address = BrokerAddress.parse(broker, "--broker")
        folder = _folder(fleet, signed, address, signed_readings)
        target = GsTarget(fog_number, drone_number, check_prefix(prefix), ttl, run, log, folder)
        if run is None:
            typer.echo(f"now let the ground station at {address} command drone {drone} of fog {fog}", err=True)
        return await _report("ground station", format_, partial(check_gs, address, target))

    run_coroutine(job())


@conformance_app.command()
def broker(
    urls: Nodes,
    side: Side = "cloud",
    prefix: Annotated[str, typer.Option(help="Prefix of the kit's topics at the broker, as acme/.")] = "",
    identity: Annotated[
        Path | None, typer.Option(help="Folder of a node's identity, for mqtts:// to a broker of its fleet.")
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="What the broker is called in the report, as `Mosquitto 2.1`.")
    ] = None,
    format_: Format = "table",
) -> None:
    """Check a broker, or a cluster: what of MQTT 5 the protocol needs of it, and what it has.

    The kit publishes and subscribes below mqttxt-conformance/, and takes back what it has retained. A rule is needed,
    useful or not used; the exit code is 1 if one that is needed failed.
    """
    from mqttxt_conformance.broker import SIDES, BrokerTarget, check_broker

    async def job() -> int:
        from ..core.transport import Transport

        if side not in SIDES:
            raise ConfigurationError(f"--side {side!r}: expected {', '.join(SIDES[:-1])} or {SIDES[-1]}")
        known = _identity(identity)
        nodes = tuple(BrokerAddress.parse(url) for url in urls)
        if known is not None:
            nodes = tuple(Transport(known).check(node, "broker") for node in nodes)
        target = BrokerTarget(nodes, check_prefix(prefix), known)
        return await _report("broker", format_, partial(check_broker, target), side, name or str(nodes[0]))

    run_coroutine(job())


def _second(url: str | None, first: BrokerAddress) -> BrokerAddress | None:
    """The second broker; the kit relays to both, which works on this machine only. Raises ConfigurationError."""
    if url is None:
        return None
    second = BrokerAddress.parse(url, "--second-broker")
    if not (second.is_loopback and first.is_loopback):
        raise ConfigurationError(f"--second-broker {second}: expected two brokers on this machine, as mqtt://127.0.0.1")
    if second.tls != first.tls or (second.host, second.port) == (first.host, first.port):
        raise ConfigurationError(f"--second-broker {second}: expected another one than {first}, as encrypted as that")
    return second


def _identity(folder: Path | None) -> Identity | None:
    """A node's identity, None without a folder; raises ConfigurationError if it cannot be used."""
    if folder is None:
        return None
    from ..security.identity import Identity

    return Identity.load(folder)


def _folder(fleet: Path | None, signed: bool, address: BrokerAddress, signed_readings: bool = False) -> Folder | None:
    """The fleet of the kit, None without `--fleet`; raises ConfigurationError."""
    from mqttxt_conformance.sealed import Folder

    from ..security.files import is_folder

    if signed_readings and not signed:
        raise ConfigurationError("--signed-readings: expected --signed beside it")
    if fleet is None:
        if signed:
            raise ConfigurationError("--signed: expected --fleet FOLDER beside it")
        return None
    if not is_folder(fleet, f"--fleet {fleet}"):
        raise ConfigurationError(f"--fleet {fleet}: no such folder; expected one that `mqttxt keys init` made")
    if not address.tls:
        raise ConfigurationError(f"--broker {address}: not encrypted; expected mqtts:// beside --fleet")
    return Folder(fleet, signed, signed_readings)


async def _report(role: str, format_: str, check: Checking, side: str | None = None, name: str | None = None) -> int:
    """Check and print; the exit code is 1 if a rule failed, for a broker one that its `side` needs."""
    from rich.console import Console

    from mqttxt_conformance.report import as_json, failures, print_table

    if format_ not in ("table", "json"):
        raise ConfigurationError(f"--format {format_!r}: expected table or json")
    progress = Console(stderr=True)

    def tell(finding: Finding) -> None:
        progress.print(f"{finding.rule.name}: {finding.verdict.value}", highlight=False)

    findings = await check(tell)
    if format_ == "json":
        typer.echo(as_json(role, findings, side, name))
    else:
        console = Console()
        print_table(role, findings, console if console.is_terminal else Console(width=140), side)
    return 1 if failures(findings, side) else 0
