"""`mqttxt broker`: the configuration of a broker of the fleet."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ..core.address import address_of
from ..errors import ConfigurationError
from ..protocol.names import MAX_FOG, check_prefix
from .common import errors_as_lines, numbers_of


class BrokerKind(StrEnum):
    """The place of the broker."""

    CLOUD = "cloud"
    FOG = "fog"
    DRONE = "drone"


class BrokerProgram(StrEnum):
    """The broker's program."""

    MOSQUITTO = "mosquitto"
    RABBITMQ = "rabbitmq"


def broker(
    kind: Annotated[BrokerKind, typer.Argument(help="Whose broker: the cloud's, a fog's, or a drone's for sensors.")],
    identity: Annotated[Path, typer.Option(help="The broker's identity, of `mqttxt keys issue broker`.")],
    out: Annotated[Path, typer.Option(help="The folder for what the broker reads.")],
    listen: Annotated[str, typer.Option(help="HOST:PORT at which it is to listen.")] = "0.0.0.0:8883",
    prefix: Annotated[str, typer.Option(help="Prefix of every topic at the cloud broker, as acme/.")] = "",
    fogs: Annotated[str, typer.Option(help="Fogs that share the cloud's broker (fogX/local/), as 1-3,7.")] = "",
    server: Annotated[
        BrokerProgram, typer.Option(help="The program: mosquitto, or rabbitmq as the cloud's.")
    ] = BrokerProgram.MOSQUITTO,
    air_sn: Annotated[
        bool, typer.Option("--air-sn", help="Of a fog: its activator, with --air-sn, brings drones to the broker.")
    ] = False,
) -> None:
    """Write a complete configuration for Mosquitto 2: mutual TLS 1.3, who may publish and hear what, limits.

    Run it again when somebody was issued or revoked, and send Mosquitto SIGHUP. For RabbitMQ 4 it adds the fleet to a
    folder of several: definitions.json with the users of all and what each may publish and hear, and fleets/NAME.
    """
    from ..security import rabbitmq
    from ..security.broker import BrokerFiles

    with errors_as_lines():
        host, port = address_of(listen, "--listen")
        sharing = numbers_of(fogs, MAX_FOG, "--fogs") if fogs else frozenset()
        files = BrokerFiles(identity, check_prefix(prefix), fogs=sharing, air=air_sn)
        if files.place.kind != kind:
            raise ConfigurationError(
                f"--identity {identity}: {files.identity.name}; expected the identity of a {kind} broker"
            )
        if prefix and kind is not BrokerKind.CLOUD:
            raise ConfigurationError(f"--prefix {prefix!r}: expected at the cloud broker alone")
        if unknown := sharing - files.fogs():
            raise ConfigurationError(f"--fogs {fogs!r}: fog {min(unknown)} is none of the fleet's")
        if fogs and kind is not BrokerKind.CLOUD:
            raise ConfigurationError(f"--fogs {fogs!r}: expected at the cloud broker alone")
        if air_sn and kind is not BrokerKind.FOG:
            raise ConfigurationError("--air-sn: expected at a fog's broker alone")
        if server is BrokerProgram.RABBITMQ and kind is not BrokerKind.CLOUD:
            raise ConfigurationError(f"--server {server}: expected at the cloud broker alone")
        if server is BrokerProgram.RABBITMQ and host != "0.0.0.0":
            raise ConfigurationError(f"--listen {listen!r}: RabbitMQ listens at every address; expected 0.0.0.0:PORT")
        typer.echo(
            rabbitmq.write(files, out, port) if server is BrokerProgram.RABBITMQ else files.write(out, host, port)
        )
