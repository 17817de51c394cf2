"""The ground station of a subcommand, and its fleet: options that are the same for each of them."""

from __future__ import annotations

import contextlib
import functools
import inspect
import secrets
from collections.abc import Awaitable, Callable, Collection, Iterable
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from ..core.address import BrokerAddress
from ..core.settings import CONNECT_S, Settings
from ..errors import ConfigurationError
from ..protocol.names import MAX_DRONE, MAX_FOG, check_prefix, parse_in_fleet
from .advice import connect, take_over_advised
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
    from ..station.fleets import Fleets
    from ..station.ground_station import GroundStation
    from ..station.views import Drone

EACH = "FLEET=VALUE,FLEET=VALUE gives each fleet its own."
Cloud = Annotated[str, typer.Option(help=f"The cloud broker: mqtt://HOST[:PORT]. {EACH}", envvar="MQTTXT_CLOUD")]
Prefix = Annotated[str, typer.Option(help="Prefix of every topic, as acme/: the fleet of numbers that name none.")]
Timeout = Annotated[float, typer.Option(help="Seconds to wait for the fog's activator.")]
IDENTITY = typer.Option(
    help=f"The folder of the station's identity, for mqtts:// (`mqttxt keys issue`). {EACH}",
    envvar="MQTTXT_IDENTITY",
)
DroneNumber = Annotated[str, typer.Option("--drone", help="The drone's number, or FLEET/NUMBER, as acme/1.")]
FogNumber = Annotated[str, typer.Option("--fog", help="The fog's number, or FLEET/NUMBER, as acme/1.")]
FogNumbers = Annotated[
    list[str],
    typer.Option("--fog", help="A fog's number, or FLEET/NUMBER, as acme/1; may be given several times."),
]
TakeOver = Annotated[bool, typer.Option("--take-over", help="Take control, if another station has it.")]
Control = bool | Collection[int]
"""As that of a ground station."""
Job = Callable[[Any], Awaitable[int]]
"""Takes a `Drone`, carries out the subcommand with it, and returns the exit code."""


@dataclass(frozen=True)
class StationOptions:
    """A station's options about its fleet. Each field is an option, which the environment may give too."""

    cloud: Cloud = "mqtt://127.0.0.1:1883"
    identity: Annotated[str | None, IDENTITY] = None
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

    def fogs_of(self, names: Iterable[str]) -> dict[str, list[int]]:
        """Parse typed fogs, each once, by fleet; raises ConfigurationError."""
        found: dict[str, list[int]] = {}
        for fleet, number in dict.fromkeys(self._named("--fog", name, MAX_FOG) for name in names):
            found.setdefault(fleet, []).append(number)
        return found

    def place_of(self, drone: str, fog: str) -> tuple[str, int, int]:
        """Parse a typed drone and fog, either of which may name the fleet; raises ConfigurationError."""
        fleet, number = self._named("--drone", drone, MAX_DRONE)
        other, place = self._named("--fog", fog, MAX_FOG)
        if fleet and other and fleet != other:
            raise ConfigurationError(f"--drone {drone} --fog {fog}: expected a drone and a fog of one fleet")
        return fleet or other, place, number

    def _named(self, option: str, text: str, most: int) -> tuple[str, int]:
        own = check_prefix(self.prefix).removesuffix("/")
        fleet, number = parse_in_fleet(option, text, most)
        if own and fleet not in ("", own):
            raise ConfigurationError(f"{option} {text}: expected one of the fleet of --prefix {self.prefix}")
        return fleet or own, number

    def joined(
        self, fleets: Iterable[str], settings: Settings | None = None, control: Control = True
    ) -> GroundStation | Fleets:
        """A station in one fleet or in several, not entered yet; raises ConfigurationError."""
        names = [*fleets]
        if len(names) == 1:
            return self.station(names[0], settings, control)
        if "" in names:
            raise ConfigurationError("--fog: expected FLEET/NUMBER of each fog, as acme/1, because they are of several")
        _check_each("--cloud", self.cloud, names)
        _check_each("--identity", self.identity or "", names)
        from ..station.fleets import Fleets

        name = f"gs-{secrets.token_hex(4)}" if self.identity is None else None
        return Fleets(*(self.station(fleet, settings, control, name) for fleet in names))

    def station(
        self, fleet: str, settings: Settings | None = None, control: Control = True, name: str | None = None
    ) -> GroundStation:
        """The ground station of a fleet (empty: no prefix), not entered yet; raises ConfigurationError."""
        from ..station.ground_station import GroundStation

        chosen = settings or Settings()
        identity = _of_fleet("--identity", self.identity, fleet) if self.identity is not None else None
        cloud = _of_fleet("--cloud", self.cloud, fleet)
        _check_cloud(cloud, identity, self.insecure)
        found = GroundStation(
            cloud,
            name=name,
            qos=chosen.qos,
            encoding=chosen.encoding,
            bundles=chosen.bundles,
            prefix=fleet,
            control=control,
            identity=identity,
            signed=self.signed,
            signed_states=self.signed_states,
            signed_readings=self.signed_readings,
            insecure=self.insecure,
        )
        if not self.timeout > 0:
            raise ConfigurationError(f"--timeout {self.timeout:g}: expected more than 0 s")
        return found


@dataclass(frozen=True)
class DroneOptions:
    """The drone of a subcommand."""

    drone: DroneNumber
    fog: FogNumber = "1"
    take_over: TakeOver = False


def of_a_station(command: Callable[..., None]) -> Callable[..., None]:
    """Make a subcommand of a function whose first parameter is the station's options; they follow its own."""
    return _with_options(command, command, StationOptions)


def with_a_drone(command: Callable[..., Job]) -> Callable[..., None]:
    """Make a subcommand of a function that returns its job with one drone, which this station controls if it may.

    The options of drone and station follow its own. Its errors are printed before any connection is made.
    """

    def run(which: DroneOptions, options: StationOptions, **own: Any) -> None:
        with errors_as_lines():
            job = command(**own)
        run_with_drone(job, which, options)

    return _with_options(run, command, DroneOptions, StationOptions)


def run_with_drone(job: Job, which: DroneOptions, options: StationOptions) -> None:
    """Run a job with a drone after waiting, up to the timeout, for control of it, and of no other drone."""
    set_up_logging(verbose=False)

    async def with_drone() -> int:
        fleet, place, number = options.place_of(which.drone, which.fog)
        async with options.station(fleet, None, (number,)) as station:
            (fog,) = await connect(station, {fleet: [place]}, options.timeout)
            there = fog.drone(number)
            if which.take_over:
                await there.take_over(timeout_s=options.timeout)
            with contextlib.suppress(TimeoutError):  # the word or the error names the station in control
                await station.wait_until(
                    lambda: there.is_controlled or _is_held_by_another(there, station.name), options.timeout
                )
            with take_over_advised():
                return await job(there)

    run_coroutine(with_drone())


def _is_held_by_another(there: Drone, own: str) -> bool:
    """Whether a live fog names another station in control. If it names none, this one may still get control."""
    return there.is_reachable and there.holder not in (None, own)


def _check_cloud(url: str, identity: str | None, insecure: bool) -> None:
    """Raises ConfigurationError, naming `--cloud`, for an address to which the station would not connect."""
    from ..core.transport import Transport

    address = BrokerAddress.parse(url, "--cloud")
    if identity is None:
        Transport(insecure=insecure).check(address, "--cloud")
    elif not address.tls:
        from ..security.identity import Identity

        Transport(Identity.load(Path(identity)), insecure).check(address, "--cloud")


def _check_each(option: str, text: str, fleets: Collection[str]) -> None:
    """Raises ConfigurationError for an option's values if one of the fleets has a value of its own and another none."""
    given = {part.partition("=")[0].removesuffix("/") for part in text.split(",")}
    missing = [fleet for fleet in fleets if fleet not in given]
    if missing and len(missing) < len(fleets):
        raise ConfigurationError(f"{option} {text}: expected a value for fleet {missing[0]} too, as {missing[0]}=VALUE")


def _of_fleet(option: str, text: str, fleet: str) -> str:
    """An option's value for a fleet: the fleet's own value if the text has one, else the whole text."""
    parts = [part.partition("=") for part in text.split(",")]
    own = [value for name, _, value in parts if name.removesuffix("/") == fleet and fleet]
    if len(own) > 1:
        raise ConfigurationError(f"{option} {text}: expected one value for fleet {fleet}")
    return own[0] if own else text


def _with_options(run: Callable[..., None], command: Callable[..., Any], *kinds: type[Any]) -> Callable[..., None]:
    """A subcommand with the parameters of `command`, then the fields of `kinds`; `run` gets instances of these."""

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
