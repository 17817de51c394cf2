"""Which ground station a subcommand is, and of which fleet: its options, the same for each of them."""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Awaitable, Callable
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from ..core.settings import CONNECT_S, Settings
from ..protocol.topics import MAX_DRONE, check_number
from .advice import connect
from .common import (
    INSECURE_HELP,
    SIGNED_HELP,
    SIGNED_READINGS_HELP,
    SIGNED_STATES_HELP,
    errors_as_lines,
    run_coroutine,
    set_up_logging,
)

if TYPE_CHECKING:
    from ..station.ground_station import GroundStation

Cloud = Annotated[str, typer.Option(help="The cloud broker: mqtt://HOST[:PORT].", envvar="MQTTXT_CLOUD")]
Prefix = Annotated[str, typer.Option(help="Prefix of every topic, as acme/.")]
Timeout = Annotated[float, typer.Option(help="Seconds to wait for the fog's activator.")]
IDENTITY = typer.Option(
    help="The folder of the station's identity, for mqtts:// (`mqttxt keys issue`).", envvar="MQTTXT_IDENTITY"
)
DroneNumber = Annotated[int, typer.Option("--drone", help="The drone's number.")]
FogNumber = Annotated[int, typer.Option("--fog", help="The fog's number.")]
TakeOver = Annotated[bool, typer.Option("--take-over", help="Take control, if another station has it.")]
Job = Callable[[Any], Awaitable[int]]
"""Takes a `Drone`, does something with it, and returns the exit code."""


@dataclass(frozen=True)
class StationOptions:
    """What a station is told of its fleet. Each field is an option, which the environment may give too."""

    cloud: Cloud = "mqtt://127.0.0.1:1883"
    identity: Annotated[Path | None, IDENTITY] = None
    signed: Annotated[bool, typer.Option("--signed", help=SIGNED_HELP, envvar="MQTTXT_SIGNED")] = False
    signed_states: Annotated[
        bool, typer.Option("--signed-states", help=SIGNED_STATES_HELP, envvar="MQTTXT_SIGNED_STATES")
    ] = False
    signed_readings: Annotated[
        bool, typer.Option("--signed-readings", help=SIGNED_READINGS_HELP, envvar="MQTTXT_SIGNED_READINGS")
    ] = False
    insecure: Annotated[bool, typer.Option("--insecure", help=INSECURE_HELP, envvar="MQTTXT_INSECURE")] = False
    prefix: Prefix = ""
    timeout: Timeout = CONNECT_S

    def station(self, settings: Settings | None = None, control: bool = True) -> GroundStation:
        """The ground station, not entered yet; raises ConfigurationError."""
        from ..station.ground_station import GroundStation

        chosen = settings or Settings()
        return GroundStation(
            self.cloud,
            qos=chosen.qos,
            encoding=chosen.encoding,
            bundles=chosen.bundles,
            prefix=self.prefix,
            control=control,
            identity=self.identity,
            signed=self.signed,
            signed_states=self.signed_states,
            signed_readings=self.signed_readings,
            insecure=self.insecure,
        )


@dataclass(frozen=True)
class DroneOptions:
    """Which drone a subcommand is for."""

    drone: DroneNumber
    fog: FogNumber = 1
    take_over: TakeOver = False


def of_a_station(command: Callable[..., None]) -> Callable[..., None]:
    """Make a subcommand of a function whose first parameter is the station's options: those stand behind its own."""
    return _with_options(command, command, StationOptions)


def with_a_drone(command: Callable[..., Job]) -> Callable[..., None]:
    """Make a subcommand of a function that returns its job with one drone, which this station controls if it may.

    The options of drone and station stand behind its own. What it raises is said before anything is connected to.
    """

    def run(which: DroneOptions, options: StationOptions, **own: Any) -> None:
        with errors_as_lines():
            job = command(**own)
        run_with_drone(job, which, options)

    return _with_options(run, command, DroneOptions, StationOptions)


def run_with_drone(job: Job, which: DroneOptions, options: StationOptions) -> None:
    """Do something with a drone that this station controls, as far as it may."""
    set_up_logging(verbose=False)

    async def with_drone() -> int:
        number = check_number("--drone", which.drone, MAX_DRONE)
        async with options.station() as station:
            (fog,) = await connect(station, [which.fog], options.timeout)
            there = fog.drone(number)
            if which.take_over:
                await there.take_over(options.timeout)
            with contextlib.suppress(TimeoutError):  # who controls it instead is in the word, or in the error
                await station.wait_until(lambda: there.is_controlled, options.timeout)
            return await job(there)

    run_coroutine(with_drone())


def _with_options(run: Callable[..., None], command: Callable[..., Any], *kinds: type[Any]) -> Callable[..., None]:
    """A subcommand with the parameters of `command`, then the fields of `kinds`, of which `run` takes instances."""

    @functools.wraps(command)
    def with_options(**given: Any) -> None:
        taken = [kind(**{field.name: given.pop(field.name) for field in fields(kind)}) for kind in kinds]
        run(*taken, **given)

    own = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in inspect.signature(command, eval_str=True).parameters.values()
        if parameter.annotation not in kinds
    ]
    for kind in kinds:
        hints = get_type_hints(kind, include_extras=True)
        for field in fields(kind):
            default = inspect.Parameter.empty if field.default is MISSING else field.default
            own.append(
                inspect.Parameter(
                    field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hints[field.name]
                )
            )
    with_options.__signature__ = inspect.Signature(own)  # type: ignore[attr-defined]
    return with_options
