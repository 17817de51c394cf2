"""The `sensor` command."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Annotated

import typer

from mqttxt.cli.common import IdentityFolder, Insecure, errors_as_lines, run_role, set_up_logging, settings
from mqttxt.cli.one_line import OneLineCommand
from mqttxt.core.address import BrokerAddress
from mqttxt.core.transport import Transport
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.names import check_number

from .model import QUANTITIES
from .node import SensorOptions
from .process import SensorRunner

FASTEST_HZ = 1000.0
SLOWEST_HZ = 1 / 86_400

app = typer.Typer(
    name="sensor", help="A sensor node of the field.", add_completion=False, pretty_exceptions_enable=False
)


@app.command(name="sensor", cls=OneLineCommand)
def run(
    broker: Annotated[str, typer.Option(help="The broker that readings go to: mqtt://HOST[:PORT].")],
    number: Annotated[int, typer.Option(help="This sensor's number, S in its topics sensorS/K.")] = 1,
    kinds: Annotated[str, typer.Option(help="What it measures.")] = ",".join(QUANTITIES),
    rate: Annotated[float, typer.Option(help="Readings of each kind a second.")] = 1.0,
    samples: Annotated[
        int | None, typer.Option(help="End after so many readings of each kind, once they are stored elsewhere.")
    ] = None,
    keep: Annotated[int, typer.Option(help="Unacknowledged readings that are kept; then the oldest go.")] = 10_000,
    when_reached: Annotated[
        bool, typer.Option("--when-reached", help="Measure from the first connection on, not from the start.")
    ] = False,
    stay: Annotated[bool, typer.Option("--stay", help="Stay connected when --samples are measured.")] = False,
    plain: Annotated[
        bool, typer.Option("--plain", help="The broker belongs to no drone: what it acknowledges is stored.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the noise: the same seed and time measure the same.")] = 1,
    events: Annotated[Path | None, typer.Option(help="File for every reading, JSON lines.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Payloads in JSON, for people, instead of CBOR.")] = False,
    identity: IdentityFolder = None,
    signed: Annotated[
        bool, typer.Option("--signed", help="Sign readings; takes --identity, and --signed-readings of the fleet.")
    ] = False,
    insecure: Insecure = False,
    ready_file: Annotated[Path | None, typer.Option(help="File touched every second while connected.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log more.")] = False,
) -> None:
    """Measure temperature, humidity and light, and publish them until Ctrl-C."""
    set_up_logging(verbose)

    def make() -> SensorRunner:
        options = SensorOptions(
            number=check_number("--number", number),
            kinds=_kinds(kinds),
            rate_hz=_rate(rate),
            seed=seed,
            samples=samples if samples is None else check_number("--samples", samples),
            keep=check_number("--keep", keep),
            when_reached=when_reached,
            stays=stay,
            plain=plain,
        )
        transport = Transport.of(identity, insecure, f"sensor{number}")
        address = transport.check(BrokerAddress.parse(broker, "--broker"), "--broker")
        return SensorRunner(
            address,
            options,
            settings(1, json),
            events=events,
            ready_file=ready_file,
            identity=transport.identity,
            seal=transport.seal(signed),
        )

    run_role(make)


def _kinds(text: str) -> tuple[str, ...]:
    found = tuple(dict.fromkeys(part.strip() for part in text.split(",")))
    if not found or not set(found) <= set(QUANTITIES):
        raise ConfigurationError(f"--kinds {text!r}: expected some of {','.join(QUANTITIES)}")
    return found


def _rate(rate_hz: float) -> float:
    if not isfinite(rate_hz) or not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise ConfigurationError(f"--rate {rate_hz:g}: expected readings a second, from once a day to {FASTEST_HZ:g}")
    return rate_hz


def main() -> None:
    """Entry point of the `sensor` command."""
    with errors_as_lines():
        app()
