"""`mqttxt keys`: a fleet's authority, and the identities that it issues."""

from __future__ import annotations

import ipaddress
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import ConfigurationError
from ..protocol.names import MAX_DRONE, MAX_FOG, MAX_SENSOR
from .common import errors_as_lines, numbers_of

if TYPE_CHECKING:
    from ..security.authority import Authority
    from ..security.certificate import Certificate
    from ..security.rights import Rights

keys_app = typer.Typer(
    help="A fleet's authority: who belongs to the fleet, with which rights.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


class Node(StrEnum):
    """The kinds of nodes for which `keys issue` issues identities."""

    DRONE = "drone"
    FOG = "fog"
    BROKER = "broker"
    STATION = "station"
    SENSOR = "sensor"


class May(StrEnum):
    """A right of a ground station."""

    COMMAND = "command"
    UPLOAD_PLAN = "upload-plan"
    SET_PARAMETERS = "set-parameters"
    TAKE_OVER = "take-over"
    OBSERVE = "observe"


FleetFolder = Annotated[
    Path | None,
    typer.Option(
        "--fleet",
        envvar="MQTTXT_FLEET",
        help="The authority's folder; without: this folder, or the only one in it.",
    ),
]
Dns = Annotated[list[str] | None, typer.Option(help="A name by which others reach the broker; several times.")]
Address = Annotated[list[str] | None, typer.Option(help="An address by which others reach the broker; several times.")]
NewDns = Annotated[list[str] | None, typer.Option(help="A broker's name, instead of those it has; several times.")]
NewAddress = Annotated[
    list[str] | None, typer.Option(help="A broker's address, instead of those it has; several times.")
]
Days = Annotated[float | None, typer.Option(help="Days until the certificate expires.")]


@keys_app.command()
def init(
    fleet: Annotated[str, typer.Argument(help="The fleet's name; a folder of this name is made.")],
    folder: Annotated[Path | None, typer.Option(help="Another folder for it.")] = None,
    fogs: Annotated[str, typer.Option(help="Also identities for these fogs and their brokers, as 1-3,7.")] = "",
    drones: Annotated[str, typer.Option(help="Also identities for these drones.")] = "",
    station: Annotated[
        str | None, typer.Option(help="Also an identity for a station with every right over every drone.")
    ] = None,
) -> None:
    """Make a new fleet: its authority's key, and where asked for, what a fleet on this machine needs."""
    from ..security.authority import STATION_DAYS, Authority
    from ..security.rights import Rights

    with errors_as_lines():
        fog_names = _names(Node.FOG, fogs, "--fogs") if fogs else []
        drone_names = _names(Node.DRONE, drones, "--drones") if drones else []
        station_names = _names(Node.STATION, station) if station is not None else []
        authority = Authority.create(folder or Path(fleet), fleet)
        brokers = ["broker-cloud", *(f"broker-{name}" for name in fog_names)]
        for name in (*(brokers if fog_names or drone_names or station_names else ()), *fog_names, *drone_names):
            authority.issue(name)
        for name in station_names:
            authority.issue(
                name, Rights(None, take_over=True, observe=True, upload_plan=True, set_parameters=True), STATION_DAYS
            )
        typer.echo(f"{authority.folder}: the authority of fleet {fleet}; keep {authority.folder}/authority.pem offline")
        _show(authority)


@keys_app.command()
def issue(
    kind: Annotated[Node, typer.Argument(help="The kind of node: drone, fog, broker, station or sensor.")],
    name: Annotated[
        str, typer.Argument(help="Its number, or several as 1-3,7; a station's name; a broker: see below.")
    ],
    may: Annotated[list[May] | None, typer.Option(help="A station's right; several times.")] = None,
    drones: Annotated[str, typer.Option(help="The drones that a station may command, as 1-3,7; * for all.")] = "",
    days: Days = None,
    dns: Dns = None,
    address: Address = None,
    fleet: FleetFolder = None,
) -> None:
    """Issue identities: a folder each, to be brought to its node.

    A broker's name is `cloud`, or its node's (`fog1`, `drone3`); a fog gets one for its broker too.
    """
    from ..security.authority import NODE_DAYS, STATION_DAYS

    with errors_as_lines():
        rights = _rights(kind, may or [], drones)
        hosts = _hosts(dns, address)
        if hosts and kind not in (Node.FOG, Node.BROKER):
            raise ConfigurationError(f"{kind} {name}: expected --dns and --address for fogs and brokers alone")
        lifetime = days if days is not None else STATION_DAYS if kind is Node.STATION else NODE_DAYS
        authority = _authority(fleet)
        names = _names(kind, name)
        beside = [f"broker-{fog}" for fog in names] if kind is Node.FOG else []
        brokers = [each for each in beside if hosts or not authority.has(each)]
        for each in (*brokers, *names):  # all of them or none
            authority.check_new(each)
        for each in brokers:
            typer.echo(authority.issue(each, days=lifetime, hosts=hosts))
        for each in names:
            typer.echo(authority.issue(each, rights, lifetime, hosts if kind is Node.BROKER else ()))


@keys_app.command()
def revoke(
    name: Annotated[str, typer.Argument(help="The node as its certificate has it: drone3, gs-ops, broker-cloud.")],
    old: Annotated[bool, typer.Option("--old", help="All but its newest certificate, after a renewal.")] = False,
    fleet: FleetFolder = None,
) -> None:
    """Revoke a node's certificates; every identity below the authority's folder gets the new list."""
    with errors_as_lines():
        authority = _authority(fleet)
        count = authority.revoke(name, only_old=old)
        number = authority.fleet.revoked.number
        typer.echo(f"{name}: {count} revoked; list {number}: {authority.folder / 'revoked.pem'}")


@keys_app.command()
def renew(
    name: Annotated[str, typer.Argument(help="The node as its certificate has it: drone3, gs-ops, broker-cloud.")],
    days: Days = None,
    dns: NewDns = None,
    address: NewAddress = None,
    fleet: FleetFolder = None,
) -> None:
    """Give a node a new key and certificate; the old one is valid until it expires or is revoked (`--old`)."""
    with errors_as_lines():
        hosts = _hosts(dns, address)
        if hosts and not name.startswith("broker-"):
            raise ConfigurationError(f"{name}: expected --dns and --address for brokers alone, as broker-fog1")
        typer.echo(_authority(fleet).renew(name, days, hosts))


@keys_app.command()
def show(
    what: Annotated[
        Path | None, typer.Argument(help="An identity's folder or a certificate; without: the fleet.")
    ] = None,
    fleet: FleetFolder = None,
) -> None:
    """Say what certificates say: name, fleet, rights, until when."""
    from ..security.files import is_folder, is_there
    from ..security.identity import CERTIFICATE_FILE, read_certificate

    with errors_as_lines():
        if what is None or is_there(what / "authority.pem"):
            _show(_authority(what or fleet))
        else:
            found = read_certificate(what / CERTIFICATE_FILE if is_folder(what) else what)
            typer.echo(f"{_line(found)}  of fleet {found.fleet}")


@keys_app.command()
def check(folder: Annotated[Path, typer.Argument(help="An identity's folder.")]) -> None:
    """Say what is wrong with an identity: a line for each thing, exit code 2."""
    from ..security.checks import problems
    from ..security.identity import Identity

    with errors_as_lines():
        found = problems(folder)
        for line in found:
            typer.echo(f"mqttxt: {line}", err=True)
        if found:
            raise typer.Exit(ConfigurationError.exit_code)
        identity = Identity.load(folder)
        typer.echo(f"{_line(identity.certificate)}  of fleet {identity.fleet.name}: good")


def _authority(fleet: Path | None) -> Authority:
    from ..security.authority import AUTHORITY_FILE, Authority

    if fleet is not None:
        return Authority.load(fleet)
    here = Path()
    if (here / AUTHORITY_FILE).exists():
        return Authority.load(here)
    found = sorted(path.parent for path in here.glob(f"*/{AUTHORITY_FILE}"))
    if len(found) != 1:
        raise ConfigurationError(f"--fleet: {len(found)} fleets in this folder; expected --fleet with one's folder")
    return Authority.load(found[0])


def _names(kind: Node, text: str, option: str | None = None) -> list[str]:
    """The names of nodes in their certificates; raises ConfigurationError."""
    from ..security.names import NodeName

    if kind is Node.STATION:
        return [str(NodeName.parse(f"gs-{text}"))]
    if kind is Node.BROKER:
        return [_broker(text)]
    most = {Node.DRONE: MAX_DRONE, Node.SENSOR: MAX_SENSOR, Node.FOG: MAX_FOG}[kind]
    return [f"{kind}{number}" for number in sorted(numbers_of(text, most, option or kind))]


def _hosts(dns: list[str] | None, address: list[str] | None) -> tuple[str, ...]:
    """The names and addresses of a broker; raises ConfigurationError for an address that is none."""
    for each in address or ():
        try:
            ipaddress.ip_address(each)
        except ValueError:
            raise ConfigurationError(f"--address {each!r}: expected an IP address; a name is --dns") from None
    return (*(dns or ()), *(address or ()))


def _broker(text: str) -> str:
    from ..security.access_list import Place
    from ..security.names import NodeName

    name = NodeName.parse(f"broker-{text}")
    Place.of_broker(name)
    return str(name)


def _rights(kind: Node, may: list[May], drones: str) -> Rights:
    from ..security.rights import EVERY, Rights

    if kind is not Node.STATION:
        if may or drones:
            raise ConfigurationError(f"{kind}: expected --may and --drones for stations alone")
        return Rights()
    if May.COMMAND in may and not drones:
        raise ConfigurationError("--may command: expected --drones beside it, as 1-3,7 or '*'")
    if drones and May.COMMAND not in may:
        raise ConfigurationError(f"--drones {drones}: expected --may command beside it")
    if not may:
        raise ConfigurationError("station: expected --may command, --may take-over or --may observe")
    for beside in (May.UPLOAD_PLAN, May.SET_PARAMETERS):
        if beside in may and May.COMMAND not in may:
            raise ConfigurationError(f"--may {beside}: expected --may command beside it, for the same drones")
    command = frozenset[int]() if not drones else None if drones == EVERY else numbers_of(drones, MAX_DRONE, "--drones")
    return Rights(command, May.TAKE_OVER in may, May.OBSERVE in may, May.UPLOAD_PLAN in may, May.SET_PARAMETERS in may)


def _show(authority: Authority) -> None:
    now_s = datetime.now(UTC).timestamp()
    for each in sorted(authority.issued(), key=lambda each: (each.name, each.not_before_s)):
        typer.echo(f"{_line(each)}  {authority.fleet.verify(each, now_s) or 'good'}")


def _line(certificate: Certificate) -> str:
    until = datetime.fromtimestamp(certificate.not_after_s, UTC)
    rights = " ".join(uri.removeprefix("mqttxt:may/") for uri in certificate.rights.uris())
    return f"{certificate.name:<16} until {until:%Y-%m-%d}  {rights}".rstrip()
