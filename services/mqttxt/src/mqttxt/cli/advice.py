"""Explanations of words and errors, for users who have not read the specification.

A station's modules are imported only where something runs: help needs none of them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup

from ..errors import BrokerRefused, ConfigurationError, FogUnreachable, NotInControl, SigningDiffers, StationEnded

if TYPE_CHECKING:
    from ..station.fleets import Fleets
    from ..station.ground_station import GroundStation
    from ..station.heard import SentCommand
    from ..station.outcomes import Outcome, PsmiList
    from ..station.views import Fog


class GroundStationCommands(TyperGroup):
    """Shows how to send a drone's command that was typed as a command of the ground station."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """As the base class does."""
        from ..protocol.commands import COMMANDS

        if args[0] in COMMANDS and args[0] not in self.commands:
            ctx.fail(f"No such command {args[0]!r}; expected `mqttxt gs send {args[0]}`.")
        return super().resolve_command(ctx, args)


def line_of(said: Outcome | PsmiList) -> str:
    """A word as a line; any but a success or a first word also with its meaning and, if known, a remedy."""
    from ..page.words import in_plain_english
    from ..protocol.messages import Word
    from ..protocol.words import NOT_IN_CONTROL
    from ..station.outcomes import Outcome

    as_wished = (Word.ACCEPTED, Word.IN_PROGRESS, Word.COMPLETED)
    if not isinstance(said, Outcome) or (said.word in as_wished and said.observed):
        return str(said)
    holder = (said.reason or "").partition(NOT_IN_CONTROL)[2]
    return f"{said}. {in_plain_english(said)}{' --take-over takes control from it.' if holder else ''}"


@contextlib.contextmanager
def told_without_last_word() -> Iterator[None]:
    """Say, where Ctrl-C, SIGTERM or the end of the station ends the wait for a command, that it goes on."""
    import asyncio

    try:
        yield
    except (asyncio.CancelledError, BrokerRefused, StationEnded):
        said = "no last word: a command that was sent goes on; `mqttxt gs send hold` stops a drone"
        typer.echo(f"mqttxt: {said}", err=True)
        raise


async def follow(sent: SentCommand[Any, Any]) -> None:
    """Print each word about a command, up to the last."""
    with told_without_last_word():
        async for said in sent:
            typer.echo(line_of(said))


async def connect(station: GroundStation | Fleets, fogs: Mapping[str, list[int]], timeout_s: float) -> list[Fog]:
    """A station's `connect`, with fogs by fleet; its error also names the command's options."""
    from ..station.ground_station import GroundStation

    try:
        if isinstance(station, GroundStation):
            return await station.connect([number for numbers in fogs.values() for number in numbers], timeout_s)
        return await station.connect(fogs, timeout_s)
    except SigningDiffers:
        raise
    except FogUnreachable as error:
        raise FogUnreachable(f"{error}; expected --cloud (or MQTTXT_CLOUD) and --fog of a running fleet") from None


@contextlib.contextmanager
def take_over_advised() -> Iterator[None]:
    """Add `--take-over` to the error about a drone that another station controls."""
    try:
        yield
    except NotInControl as error:
        advice = "; --take-over takes control from it" if error.holder is not None else ""
        raise ConfigurationError(f"{error}{advice}") from None


def not_there(fog: Fog, drone: int) -> str | None:
    """A line with the fog's drones if `drone` is none of them, else None."""
    known = [one.number for one in fog.drones]
    if drone in known:
        return None
    return f"fog {fog.number}: has no drone {drone}; its drones: {', '.join(map(str, known)) or 'none'}"
