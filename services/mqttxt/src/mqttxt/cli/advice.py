"""What the command adds to a word or an error, for somebody who has not read the specification.

What a station needs is imported by what runs: help needs none of it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from typer.core import TyperGroup

from ..errors import ConfigurationError, FogUnreachable

if TYPE_CHECKING:
    from ..station.fleets import Fleets
    from ..station.ground_station import GroundStation
    from ..station.outcomes import Outcome, PsmiList
    from ..station.views import Fog


class GroundStationCommands(TyperGroup):
    """Says where a drone's command belongs that was typed as a command of the ground station."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """As the base class does."""
        from ..protocol.commands import COMMANDS

        if args[0] in COMMANDS and args[0] not in self.commands:
            ctx.fail(f"No such command {args[0]!r}; expected `mqttxt gs send {args[0]}`.")
        return super().resolve_command(ctx, args)


def line_of(said: Outcome | PsmiList) -> str:
    """A word as it is printed; one that is not as wished with what it means, and what can be done."""
    from ..page.words import in_plain_english
    from ..protocol.messages import Word
    from ..protocol.words import NOT_IN_CONTROL
    from ..station.outcomes import Outcome

    as_wished = (Word.ACCEPTED, Word.IN_PROGRESS, Word.COMPLETED)
    if not isinstance(said, Outcome) or (said.word in as_wished and said.observed):
        return str(said)
    holder = (said.reason or "").partition(NOT_IN_CONTROL)[2]
    return f"{said}. {in_plain_english(said)}{' --take-over takes control from it.' if holder else ''}"


async def connect(station: GroundStation | Fleets, fogs: Mapping[str, list[int]], timeout_s: float) -> list[Fog]:
    """`connect` of a station, with fogs by their fleets; its error names the options of the command too."""
    from ..station.ground_station import GroundStation

    try:
        if isinstance(station, GroundStation):
            return await station.connect([number for numbers in fogs.values() for number in numbers], timeout_s)
        return await station.connect(fogs, timeout_s)
    except FogUnreachable as error:
        if "--signed" in str(error):
            raise
        raise FogUnreachable(f"{error}; expected --cloud (or MQTTXT_CLOUD) and --fog of a running fleet") from None


@contextlib.contextmanager
def take_over_advised() -> Iterator[None]:
    """The error of a drone that another station controls names the option that takes control from it."""
    from ..station.views.drone import NotInControl

    try:
        yield
    except NotInControl as error:
        advice = "; expected --take-over" if error.holder is not None else ""
        raise ConfigurationError(f"{error}{advice}") from None


def not_there(fog: Fog, drone: int) -> str | None:
    """A line that says which drones a fog has, where that one is none of them."""
    known = [one.number for one in fog.drones]
    if drone in known:
        return None
    return f"fog {fog.number}: has no drone {drone}; its drones: {', '.join(map(str, known)) or 'none'}"
