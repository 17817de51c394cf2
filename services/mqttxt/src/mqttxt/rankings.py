"""The messages of the two rankings: PSMI, which chooses a drone for a mission item, and QoDS (protocol, 7 and 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from .commands import COMMAND, Command
from .messages import CommandId, CommandMessage, Limit
from .wire.fields import (
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

Metres = Annotated[float, Scaled(10, 0, 100_000_000)]
Seconds = Annotated[float, Scaled(10, 0, 100_000_000)]
Speed = Annotated[float, Scaled(100, 0, 655)]
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
class SelectMessage:
    """A command for whichever drone PSMI chooses; the fields are those of a command.

    `offer` reserves the best drone for `limit_s` and sends nothing; `commit` sends the command to the drone that
    the same station's offer number `reservation` has reserved; `release` gives it up.
    """

    version: Version = VERSION
    gs_session: Session
    seq: U32
    executor_session: U32
    deadline_ms: Milliseconds | None = None
    limit_s: Limit
    epoch: U32 = 0
    mode: SelectMode
    reservation: U32 | None = None
    command: Annotated[Command, COMMAND]

    @property
    def id(self) -> CommandId:
        return CommandId(self.gs_session, self.seq)

    def as_command(self) -> CommandMessage:
        """The command that the chosen drone gets."""
        return CommandMessage(
            gs_session=self.gs_session,
            seq=self.seq,
            executor_session=self.executor_session,
            deadline_ms=self.deadline_ms,
            limit_s=self.limit_s,
            epoch=self.epoch,
            command=self.command,
        )


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
class PsmiMessage:
    """PSMI's list for a command id, on `fogX/PSMI`: who comes first, who is left out and why.

    `chosen` is the drone that the command went to, or that is reserved until `hold_until_ms` of the activator's
    clock.
    """

    version: Version = VERSION
    gs_session: Session
    seq: U32
    session: Session
    stamp: Stamp
    listed: Annotated[tuple[Candidate, ...], Items(250)]
    left_out: Annotated[tuple[Candidate, ...], Items(250)]
    chosen: DroneNumber | None = None
    hold_until_ms: Milliseconds | None = None

    @property
    def id(self) -> CommandId:
        return CommandId(self.gs_session, self.seq)


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
