"""Which ground station a subcommand is, and of which fleet: its options, the same for each of them."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from ..core.settings import CONNECT_S, Settings
from .common import INSECURE_HELP, SIGNED_HELP, SIGNED_READINGS_HELP, SIGNED_STATES_HELP

if TYPE_CHECKING:
    from ..station.ground_station import GroundStation

Cloud = Annotated[str, typer.Option(help="The cloud broker: mqtt://HOST[:PORT].", envvar="MQTTXT_CLOUD")]
Prefix = Annotated[str, typer.Option(help="Prefix of every topic, as acme/.")]
Timeout = Annotated[float, typer.Option(help="Seconds to wait for the fog's activator.")]
IDENTITY = typer.Option(
    help="The folder of the station's identity, for mqtts:// (`mqttxt keys issue`).", envvar="MQTTXT_IDENTITY"
)


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


def of_a_station(command: Callable[..., None]) -> Callable[..., None]:
    """Make a subcommand of a function whose first parameter is the station's options: those stand behind its own."""
    names = [field.name for field in fields(StationOptions)]

    @functools.wraps(command)
    def with_options(**given: Any) -> None:
        own = {name: given.pop(name) for name in names}
        command(StationOptions(**own), **given)

    _, *own = inspect.signature(command, eval_str=True).parameters.values()
    hints = get_type_hints(StationOptions, include_extras=True)
    options = [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=hints[field.name]
        )
        for field in fields(StationOptions)
    ]
    keywords = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in own]
    with_options.__signature__ = inspect.Signature([*keywords, *options])  # type: ignore[attr-defined]
    return with_options
