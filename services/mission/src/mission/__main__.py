"""`mission fly SCENARIO`: fly a scenario and write down what happens."""

from __future__ import annotations

import asyncio
import contextlib
import faulthandler
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from mqttxt import ConfigurationError

from . import flight
from .events import EventLog
from .fleet import Fleet, MessageFleet
from .message_set import MessageSet
from .mqttxt_fleet import MqttxtFleet
from .mqttxt_messages import MqttxtMessageFleet
from .options import COMMANDINGS, MESSAGES, PROTOCOLS, STATES, STREAMS, Options, parse_fleet, parse_urls
from .own import SUFFIX, Mission, mission_of
from .points import points_of
from .scenarios import SCENARIOS, WITH_POINTS, WITH_SENSORS
from .side_channel import SideChannel
from .steps import SAMPLES, Steps

Over = TypeVar("Over", bound=MqttxtFleet)
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.callback()
def about() -> None:
    """The ground station's side of an experiment."""


@app.command()
def fly(
    scenario: Annotated[
        str, typer.Argument(help=f"One of {', '.join((*SCENARIOS, MESSAGES))}, or a .py file of your own.")
    ],
    fleet: Annotated[str, typer.Option(help="Fogs and their drones, as 1:1,2,3;2:4,5,6.")],
    events: Annotated[Path, typer.Option(help="File for what happens, JSON lines.")],
    protocol: Annotated[str, typer.Option(help=f"One of {', '.join(PROTOCOLS)}.")] = "mqttxt",
    cloud: Annotated[
        str, typer.Option(help="mqttxt: the cloud broker, mqtt://HOST[:PORT].", envvar="MQTTXT_CLOUD")
    ] = "",
    identity: Annotated[
        Path | None, typer.Option(help="mqttxt: the folder of the station's identity; without: unencrypted.")
    ] = None,
    signed: Annotated[bool, typer.Option("--signed", help="mqttxt: sign, and hear only what is signed.")] = False,
    gateway: Annotated[bool, typer.Option("--gateway", help="mqttxt: fly with MAVSDK, by mqttxt gs mavlink.")] = False,
    qos: Annotated[str, typer.Option(help="mqttxt: QoS of commands, 0 or 1.")] = "1",
    states: Annotated[str, typer.Option(help=f"mqttxt: {', '.join(STATES)}.")] = "on-change",
    mavlink: Annotated[
        str, typer.Option(help="mavlink: where MAVSDK connects, a list; udpin://HOST:PORT for each drone or for all.")
    ] = "",
    streams: Annotated[str, typer.Option(help=f"mavlink: {', '.join(STREAMS)}.")] = "px4-onboard",
    commanding: Annotated[str, typer.Option(help=f"mavlink, --gateway: {', '.join(COMMANDINGS)}.")] = "one-by-one",
    samples: Annotated[int, typer.Option(help="Values of each series that sensors measure, one a second.")] = SAMPLES,
    sensors: Annotated[Path | None, typer.Option(help="Folder of what the sensors write down, sensorY.jsonl.")] = None,
    series: Annotated[Path | None, typer.Option(help="File for the check of what arrived of that, JSON.")] = None,
    sensor_broker: Annotated[
        str, typer.Option(help="mavlink: the broker where readings arrive, mqtt://HOST[:PORT].")
    ] = "",
    count: Annotated[int, typer.Option(help="messages: how many of each kind.")] = 10,
    control: Annotated[Path | None, typer.Option(help="messages: the control socket of the stand-in.")] = None,
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
            count=count,
            control=control,
            identity=identity,
            signed=signed,
            gateway=gateway,
        )
        known = (scenario,) if scenario.endswith(SUFFIX) else (*SCENARIOS, MESSAGES)
        options.check(known, WITH_SENSORS)
        if scenario in (*WITH_POINTS, MESSAGES):
            points_of(drone for drones in options.fleet.values() for drone in drones)
        mission = None if scenario == MESSAGES else mission_of(scenario)
        log = EventLog(events)
        if mission is None:
            flying, mission = make_message_set(options, log)
        else:
            flying = make_fleet(options, log)
    except (ValueError, OSError) as error:
        typer.echo(f"mission: {error}", err=True)
        raise typer.Exit(2) from None
    reason = asyncio.run(flight.fly(options, mission, flying, log))
    log.close()
    if reason is not None:
        which = "" if scenario.endswith(SUFFIX) else f"{scenario} failed: "  # a file's errors already name it
        typer.echo(f"mission: {which}{reason}", err=True)
        raise typer.Exit(1)


def make_fleet(options: Options, log: EventLog) -> Fleet:
    """The fleet for a protocol. Raises ValueError for options that do not fit it."""
    with _settings_as_values():
        if options.protocol == "mavlink":
            from .mavsdk_fleet import MavsdkFleet  # only now: MAVSDK is a large library, which MQTT-XT does not need

            return MavsdkFleet(
                options.urls,
                options.fleet,
                commanding=options.commanding,
                streams=options.streams,
                log=log,
                sensor_broker=options.sensor_broker,
            )
        if options.gateway:
            from .gateway_fleet import GatewayFleet

            return GatewayFleet(options, log)
        return _over_mqttxt(MqttxtFleet, options, log)


def make_message_set(options: Options, log: EventLog) -> tuple[Fleet, Mission]:
    """The fleet and the mission of the message set. Raises ValueError as `make_fleet`."""
    fleet = _make_message_fleet(options, log)

    async def mission(flown: Fleet, steps: Steps) -> None:
        assert options.control is not None
        async with SideChannel(options.control) as channel:
            await MessageSet(fleet, log, channel, options.count).fly()

    return fleet, mission


def _make_message_fleet(options: Options, log: EventLog) -> MessageFleet:
    with _settings_as_values():
        if options.protocol == "mavlink":
            from .mavsdk_messages import MavsdkMessageFleet

            return MavsdkMessageFleet(options.urls, options.fleet, options.commanding, options.streams, log)
        return _over_mqttxt(MqttxtMessageFleet, options, log)


def _over_mqttxt(kind: type[Over], options: Options, log: EventLog) -> Over:
    return kind(
        options.cloud,
        options.fleet,
        qos=int(options.qos),
        log=log,
        states=options.states,
        identity=options.identity,
        signed=options.signed,
    )


@contextlib.contextmanager
def _settings_as_values() -> Iterator[None]:
    try:
        yield
    except ConfigurationError as error:
        raise ValueError(str(error)) from error


if __name__ == "__main__":
    faulthandler.enable()  # MAVSDK is a library in C++ in this process
    sys.exit(app())
