"""`mqttxt activator`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ..core.address import BrokerAddress, address_of
from ..errors import ConfigurationError
from ..protocol.names import MAX_DRONE, check_number, check_root
from .common import (
    AuditPath,
    AuditRequired,
    IdentityFolder,
    Insecure,
    Signed,
    SignedReadings,
    SignedStates,
    audit_log,
    check_system,
    numbers_of,
    run_role,
    set_up_logging,
    settings,
)
from .node_options import BrokerIdentity, Json, Qos, Ready, Verbose, embedded_broker, second_address

if TYPE_CHECKING:
    from ..activator.process import ActivatorRunner
    from ..core.transport import Transport

Prefix = Annotated[str, typer.Option(help="Prefix of every topic at the cloud broker, as acme/.")]


def activator(
    fog: Annotated[int, typer.Option(help="This fog's number.")],
    cloud: Annotated[str, typer.Option(help="The cloud broker: mqtt://HOST[:PORT].")],
    listen: Annotated[
        str | None,
        typer.Option(help="HOST:PORT of the embedded broker; 0.0.0.0:8883 with an identity, else 0.0.0.0:1883."),
    ] = None,
    fog_broker: Annotated[
        str | None, typer.Option(help="A broker that runs elsewhere, instead of the embedded one.")
    ] = None,
    second_fog_broker: Annotated[
        str | None, typer.Option(help="Another broker of this fog, for drones that connect to two.")
    ] = None,
    air_sn: Annotated[
        str | None,
        typer.Option(help="HOST:PORT where UAV clients come by MQTT-SN over UDP (mqtt-sn://); without: none."),
    ] = None,
    fog_root: Annotated[str | None, typer.Option(help="Root of the fog side's topics, as fog1/local/.")] = None,
    drones: Annotated[
        str, typer.Option(help="Numbers of the fog's drones, as 1-3,7: a broadcast awaits them, there or not.")
    ] = "",
    identity: IdentityFolder = None,
    broker_identity: BrokerIdentity = None,
    signed: Signed = False,
    signed_states: SignedStates = False,
    signed_readings: SignedReadings = False,
    insecure: Insecure = False,
    audit: AuditPath = None,
    audit_required: AuditRequired = False,
    qos: Qos = 1,
    json: Json = False,
    prefix: Prefix = "",
    ready_file: Ready = None,
    verbose: Verbose = False,
) -> None:
    """Run a fog's activator and its embedded broker."""
    check_system("activator")
    from ..activator.process import ActivatorRunner
    from ..core.transport import Transport

    set_up_logging(verbose)

    def make() -> ActivatorRunner:
        number = check_number("--fog", fog)
        transport = Transport.of(identity, insecure, f"fog{number}")
        cloud_broker = transport.check(BrokerAddress.parse(cloud, "--cloud"), "--cloud")
        embedded = None
        if fog_broker is not None and listen is not None:
            raise ConfigurationError(f"--listen {listen}: expected none beside --fog-broker, which runs elsewhere")
        if fog_broker is None:
            where = listen or ("0.0.0.0:8883" if transport.identity is not None else "0.0.0.0:1883")
            embedded = embedded_broker(where, transport, broker_identity, cuts=not signed, air=air_sn is not None)
        elif broker_identity is not None:
            raise ConfigurationError(f"--broker-identity {broker_identity}: expected none beside --fog-broker")
        fog_url = fog_broker if fog_broker is not None else embedded.url if embedded is not None else ""
        advertised = embedded.url_towards(cloud_broker.host, cloud_broker.port) if embedded is not None else None
        first = transport.check(BrokerAddress.parse(fog_url, "--fog-broker"), "--fog-broker")
        return ActivatorRunner(
            number,
            cloud_broker,
            first,
            settings(qos, json),
            drones=tuple(sorted(numbers_of(drones, MAX_DRONE, "--drones"))) if drones else (),
            embedded=embedded,
            second=second_address(second_fog_broker, "--second-fog-broker", transport, first, cloud_broker),
            advertised=BrokerAddress.parse(advertised) if advertised is not None else None,
            fog_root=check_root(fog_root) if fog_root is not None else None,
            prefix=prefix,
            ready_file=ready_file,
            identity=transport.identity,
            seal=transport.seal(signed, signed_states, signed_readings),
            audit=audit_log(audit, audit_required, f"fog{number}", transport),
            air=_air(air_sn, transport, signed),
        )

    run_role(make)


def _air(where: str | None, transport: Transport, signed: bool) -> tuple[str, int] | None:
    """The address for UAV clients that use datagrams, None without `--air-sn`; raises ConfigurationError."""
    if where is None:
        return None
    host, port = address_of(where, "--air-sn")
    transport.check(BrokerAddress(host, port, datagrams=True), "--air-sn", signed)
    return host, port
