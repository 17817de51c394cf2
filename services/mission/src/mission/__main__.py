"""`mission fly SCENARIO`: fly a scenario and write down what happens."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Annotated

import typer

from mqttxt import ConfigurationError

from . import flight
from .events import EventLog
from .fleet import Fleet
from .mqttxt_fleet import MqttxtFleet
from .options import COMMANDINGS, PROTOCOLS, STATES, STREAMS, Options, parse_fleet, parse_urls
from .own import SUFFIX, mission_of
from .points import points_of
from .scenarios import SCENARIOS, WITH_POINTS, WITH_SENSORS
from .steps import SAMPLES

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.callback()
def about() -> None:
    """The ground station's side of an experiment."""


@app.command()
def fly(
    scenario: Annotated[str, typer.Argument(help=f"One of {', '.join(SCENARIOS)}, or a .py file of your own.")],
    fleet: Annotated[str, typer.Option(help="Fogs and their drones, as 1:1,2,3;2:4,5,6.")],
    events: Annotated[Path, typer.Option(help="File for what happens, JSON lines.")],
    protocol: Annotated[str, typer.Option(help=f"One of {', '.join(PROTOCOLS)}.")] = "mqttxt",
    cloud: Annotated[
        str, typer.Option(help="mqttxt: the cloud broker, mqtt://HOST[:PORT].", envvar="MQTTXT_CLOUD")
    ] = "",
    qos: Annotated[str, typer.Option(help="mqttxt: QoS of commands, 0 or 1.")] = "1",
    states: Annotated[str, typer.Option(help=f"mqttxt: {', '.join(STATES)}.")] = "on-change",
    mavlink: Annotated[
        str, typer.Option(help="mavlink: where MAVSDK connects, a list; udpin://HOST:PORT for each drone or for all.")
    ] = "",
    streams: Annotated[str, typer.Option(help=f"mavlink: {', '.join(STREAMS)}.")] = "px4-onboard",
    commanding: Annotated[str, typer.Option(help=f"mavlink: {', '.join(COMMANDINGS)}.")] = "one-by-one",
    samples: Annotated[int, typer.Option(help="Values of each series that sensors measure, one a second.")] = SAMPLES,
    sensors: Annotated[Path | None, typer.Option(help="Folder of what the sensors write down, sensorY.jsonl.")] = None,
    series: Annotated[Path | None, typer.Option(help="File for the check of what arrived of that, JSON.")] = None,
    sensor_broker: Annotated[
        str, typer.Option(help="mavlink: the broker where readings arrive, mqtt://HOST[:PORT].")
    ] = "",
    links_start: Annotated[
        Path | None, typer.Option(help="Empty file that is made at t = 0, for the clock of the links' events.")
    ] = None,
) -> None:
    """Fly a scenario; exit code 0 when it was completed, 1 when it failed."""
    try:
        options = Options(
            scenario=scenario,
            protocol=protocol,
            fleet=parse_fleet(fleet),
            cloud=cloud,
            qos=qos,
            states=states,
            urls=parse_urls(mavlink) if protocol == "mavlink" else (),
            streams=streams,
            commanding=commanding,
            samples=samples,
            sensors=sensors,
            series=series,
            sensor_broker=sensor_broker,
            links_start=links_start,
        )
        options.check((scenario,) if scenario.endswith(SUFFIX) else tuple(SCENARIOS), WITH_SENSORS)
        if scenario in WITH_POINTS:
            points_of(drone for drones in options.fleet.values() for drone in drones)
        mission = mission_of(scenario)
        log = EventLog(events)
        flying = make_fleet(options, log)
    except (ValueError, OSError) as error:
        typer.echo(f"mission: {error}", err=True)
        raise typer.Exit(2) from None
    reason = asyncio.run(flight.fly(options, mission, flying, log))
    log.close()
    if reason is not None:
        typer.echo(f"mission: {scenario} failed: {reason}", err=True)
        raise typer.Exit(1)


def make_fleet(options: Options, log: EventLog) -> Fleet:
    """The fleet of a protocol. Raises ValueError for options that it cannot work with."""
    try:
        return _make_fleet(options, log)
    except ConfigurationError as error:
        raise ValueError(str(error)) from error


def _make_fleet(options: Options, log: EventLog) -> Fleet:
    if options.protocol == "mavlink":
        from .mavsdk_fleet import MavsdkFleet  # only now: MAVSDK is a large library, and nothing of it is MQTT-XT's

        how = (options.commanding, options.streams, log, options.sensor_broker)
        return MavsdkFleet(options.urls, options.fleet, *how)
    return MqttxtFleet(options.cloud, options.fleet, int(options.qos), log, options.states)


if __name__ == "__main__":
    sys.exit(app())
