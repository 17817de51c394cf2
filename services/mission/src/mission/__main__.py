"""`mission fly SCENARIO`: fly a scenario and write down what happens."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Annotated

import typer

from .events import EventLog
from .fleet import Fleet, MissionError
from .mqttxt_fleet import MqttxtFleet
from .scenarios import SCENARIOS
from .steps import Steps

CONNECT_LIMIT_S = 30.0

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.callback()
def about() -> None:
    """The ground station's side of an experiment."""


@app.command()
def fly(
    scenario: Annotated[str, typer.Argument(help=f"One of {', '.join(SCENARIOS)}.")],
    fleet: Annotated[str, typer.Option(help="Fogs and their drones, as 1:1,2,3;2:4,5,6.")],
    cloud: Annotated[str, typer.Option(help="The cloud broker: mqtt://HOST[:PORT].", envvar="MQTTXT_CLOUD")],
    events: Annotated[Path, typer.Option(help="File for what happens, JSON lines.")],
    qos: Annotated[int, typer.Option(help="QoS of commands: 0 or 1.")] = 1,
) -> None:
    """Fly a scenario; exit code 0 when it was completed, 1 when it failed."""
    if scenario not in SCENARIOS:
        typer.echo(f"mission: scenario {scenario!r}: expected one of {', '.join(SCENARIOS)}", err=True)
        raise typer.Exit(2)
    try:
        parsed = parse_fleet(fleet)
        log = EventLog(events)
    except (ValueError, OSError) as error:
        typer.echo(f"mission: {error}", err=True)
        raise typer.Exit(2) from None
    reason = asyncio.run(_fly(scenario, MqttxtFleet(cloud, parsed, qos, log), log))
    log.close()
    if reason is not None:
        typer.echo(f"mission: {scenario} failed: {reason}", err=True)
        raise typer.Exit(1)


def parse_fleet(text: str) -> dict[int, tuple[int, ...]]:
    """`1:1,2,3;2:4,5,6` as fogs and their drones; raises ValueError."""
    try:
        pairs = [part.split(":") for part in text.split(";")]
        return {int(fog): tuple(int(drone) for drone in drones.split(",")) for fog, drones in pairs}
    except ValueError:
        raise ValueError(f"--fleet {text!r}: expected FOG:DRONE,DRONE;FOG:DRONE, as 1:1,2,3;2:4,5,6") from None


async def _fly(scenario: str, fleet: Fleet, log: EventLog) -> str | None:
    """Fly it; returns why it failed, None when it did not."""
    reason = None
    try:
        await fleet.connect(CONNECT_LIMIT_S)
        log.write("mission_start", scenario=scenario, drones=list(fleet.drones))
        await SCENARIOS[scenario](fleet, Steps(fleet, log))
    except MissionError as error:
        reason = str(error)
    finally:
        await fleet.close()
    log.write("mission_end", status="failed" if reason else "completed", reason=reason)
    return reason


if __name__ == "__main__":
    sys.exit(app())
