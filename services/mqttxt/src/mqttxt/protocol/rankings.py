"""The messages of the two rankings: PSMI, which chooses a drone for a mission item, and QoDS (protocol, 7 and 8)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

from .commands import COMMAND, Command
from .fields import (
    U32,
    VERSION,
    DroneNumber,
    Integer,
    Items,
    Milliseconds,
    Named,
    Reason,
    Scaled,
    Session,
    Stamp,
    Version,
)
from .messages import AboutCommand, CommandHead, CommandMessage
from .states import Speed

Metres = Annotated[float, Scaled(10, 0, 100_000_000)]
Seconds = Annotated[float, Scaled(10, 0, 100_000_000)]
Percent = Annotated[int, Integer(0, 100)]
Age = Annotated[float, Scaled(10, 0, 1000)]
"""Seconds: an upper bound of how old the oldest figure was."""


class SelectMode(Named):
    """What a message on `fogX/commands/C` asks: one fog to choose and send, or one step of a choice across fogs."""

    SELECT = 1
    OFFER = 2
    COMMIT = 3
    RELEASE = 4


@dataclass(frozen=True, kw_only=True)
class SelectMessage(CommandHead):
    """A command for whichever drone PSMI chooses; the fields are those of a command.

    `offer` reserves the best drone for `limit_s` and sends nothing, with `reservation` the best beside those that the
    same station's offer of that number, and those before it, were for; `commit` sends the command to the drone that
    the same station's offer number `reservation` has reserved; `release` gives it up.
    """

    mode: SelectMode
    reservation: U32 | None = None
    command: Annotated[Command, COMMAND]

    def as_command(self) -> CommandMessage:
        """The command for the chosen drone."""
        head = {field.name: getattr(self, field.name) for field in fields(CommandHead)}
        return CommandMessage(**head, command=self.command)


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One drone in PSMI's list with every figure that was used; `reason` says why it is left out."""

    drone: DroneNumber
    reason: Reason | None = None
    distance_m: Metres | None = None
    arrival_s: Seconds | None = None
    max_groundspeed_m_s: Speed | None = None
    remaining_pct: Percent | None = None
    range_m: Metres | None = None
    age_s: Age | None = None


@dataclass(frozen=True, kw_only=True)
class PsmiMessage(AboutCommand):
    """PSMI's list for a command id, on `fogX/PSMI`: who comes first, who is left out and why.

    `chosen` is the drone that the command went to, or that is reserved until `hold_until_ms` of the activator's
    clock.
    """

    session: Session
    stamp: Stamp
    listed: Annotated[tuple[Candidate, ...], Items(250)]
    left_out: Annotated[tuple[Candidate, ...], Items(250)]
    chosen: DroneNumber | None = None
    hold_until_ms: Milliseconds | None = None


@dataclass(frozen=True, kw_only=True)
class Ranked:
    """One available drone in QoDS's ranking."""

    drone: DroneNumber
    remaining_pct: Percent
    max_groundspeed_m_s: Speed
    age_s: Age


@dataclass(frozen=True, kw_only=True)
class QodsMessage:
    """The available drones of a fog, best first, on `fogX/QoDS`."""

    version: Version = VERSION
    session: Session
    stamp: Stamp
    ranking: Annotated[tuple[Ranked, ...], Items(250)]
