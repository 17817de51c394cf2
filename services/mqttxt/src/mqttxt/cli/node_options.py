"""Common to an activator and a UAV client: options, and the embedded broker."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.address import BrokerAddress, address_of, host_port
from ..errors import ConfigurationError
from .common import named

if TYPE_CHECKING:
    from ..core.embedded_broker import EmbeddedBroker
    from ..core.transport import Transport
    from ..drone.mavlink.transports import AutopilotAddress

Qos = Annotated[int, typer.Option(help="QoS of commands and results: 0 or 1.")]
Json = Annotated[bool, typer.Option("--json", help="Payloads in JSON, for people, instead of CBOR.")]
Ready = Annotated[
    Path | None,
    typer.Option(help="File that is touched every second while the role is ready, for health checks."),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Log more.")]
BrokerIdentity = Annotated[
    Path | None,
    typer.Option(help="The folder of the embedded broker's identity; without: broker-NODE beside the node's."),
]


def autopilot_address(text: str) -> AutopilotAddress:
    """The autopilot's address from `--autopilot`; raises ConfigurationError."""
    from ..drone.mavlink.transports import AutopilotAddress

    with named("--autopilot"):
        return AutopilotAddress.parse(text)


def embedded_broker(
    listen: str,
    transport: Transport,
    broker_identity: Path | None,
    option: str = "--listen",
    instead: str = "--fog-broker",
    cuts: bool = True,
    air: bool = False,
) -> EmbeddedBroker:
    """The node's embedded broker. If the node has an identity, the broker needs one too; raises ConfigurationError.

    `air`: drones may connect through the fog's activator.
    """
    from ..core.embedded_broker import EmbeddedBroker
    from ..security.broker import BrokerFiles

    host, port = address_of(listen, option)
    identity = transport.identity
    if identity is None:
        if broker_identity is not None:
            raise ConfigurationError(f"--broker-identity {broker_identity}: expected --identity beside it")
        if not (transport.insecure or BrokerAddress(host, port).is_loopback):
            here = host_port("127.0.0.1", port)
            raise ConfigurationError(
                f"{option} {host_port(host, port)}: open to other machines, and not encrypted; "
                f"expected --identity FOLDER, {here}, or --insecure"
            )
        return EmbeddedBroker(host, port, option=option, instead=instead)
    name = f"broker-{identity.name}"
    folder = broker_identity or identity.folder.absolute().with_name(name)
    files = BrokerFiles(folder, air=air)
    if files.identity.name != name:
        raise ConfigurationError(f"--broker-identity {folder}: {files.identity.name}; expected {name}")
    if files.identity.fleet.key_hash != identity.fleet.key_hash:
        raise ConfigurationError(f"--broker-identity {folder}: of another fleet; expected that of {identity.folder}")
    return EmbeddedBroker(host, port, option=option, instead=instead, files=files, cuts=cuts)


def second_address(url: str | None, option: str, transport: Transport, *others: BrokerAddress) -> BrokerAddress | None:
    """The address of a fog's second broker, None without `url`; raises ConfigurationError."""
    if url is None:
        return None
    address = transport.check(BrokerAddress.parse(url, option), option)
    if any((address.host, address.port) == (other.host, other.port) for other in others):
        raise ConfigurationError(f"{option} {address}: is another option's address too; expected one of its own")
    return address
