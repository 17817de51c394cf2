"""The messages that travel on MQTT-XT's topics, as frozen dataclasses (docs/protocol.md, sections 3 to 9).

Every message begins with the payload's version, except beacons, states and bundles of states: they belong to a session
whose birth named it. Times are milliseconds in the session clock of the node that the field names.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, NamedTuple, Self

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
    Text,
    Version,
)

Limit = Annotated[float, Scaled(10, 0.1, 86_400)]
"""Seconds within which a command must end."""


class CommandId(NamedTuple):
    """What names a command from end to end: the ground station's session and its sequence number."""

    gs_session: int
    seq: int

    def __str__(self) -> str:
        return f"{self.gs_session:08x}:{self.seq}"


class Word(Named):
    """The words of a result: first words, then exactly one last word for each drone."""

    ACCEPTED = 1
    IN_PROGRESS = 2
    COMPLETED = 3
    DENIED = 4
    UNSUPPORTED = 5
    FAILED = 6
    EXPIRED = 7
    OVERTAKEN = 8
    SUPERSEDED = 9
    UNREACHABLE = 10
    UNCONFIRMED = 11

    @property
    def is_last(self) -> bool:
        return self not in (Word.ACCEPTED, Word.IN_PROGRESS)

    @property
    def is_definite_no(self) -> bool:
        """Whether it means that the command was not started, and will not be."""
        return self in (Word.DENIED, Word.UNSUPPORTED, Word.EXPIRED, Word.OVERTAKEN, Word.UNREACHABLE)


def without_contradiction(word: Word, reason: str | None, earlier: Word | None) -> tuple[Word, str | None]:
    """The word to publish after an earlier one. A definite no after a first word, as from an executor that restarted
    and remembers nothing, becomes `unconfirmed`: the command may go on."""
    if earlier is None or earlier.is_last or not word.is_definite_no:
        return word, reason
    return Word.UNCONFIRMED, f"{word.label} after {earlier.label}"


@dataclass(frozen=True, kw_only=True)
class BeaconMessage:
    """A process's own clock, on `fogX/clock` and `droneY/clock` (section 4).

    Where messages are signed, `revoked` is the number of the newest revocation list that its node has.
    """

    session: Session
    now_ms: Milliseconds
    nonce: U32 | None = None
    held_ms: Milliseconds | None = None
    revoked: U32 | None = None


@dataclass(frozen=True, kw_only=True)
class AboutCommand:
    """What every message about a command leads with."""

    version: Version = VERSION
    gs_session: Session
    seq: U32

    @cached_property
    def id(self) -> CommandId:
        return CommandId(self.gs_session, self.seq)


@dataclass(frozen=True, kw_only=True)
class CommandHead(AboutCommand):
    """A command without what it says: who is to execute it, when at the latest, and under whose control."""

    executor_session: U32
    deadline_ms: Milliseconds | None = None
    limit_s: Limit
    epoch: U32 = 0


@dataclass(frozen=True, kw_only=True)
class CommandMessage(CommandHead):
    """A command for the executor whose session it names, started no later than `deadline_ms` of its clock.

    A deadline that is past makes the message a query; 0 is always past. None: the sender had no beacon.
    `epoch` is that of the sender's control of the drone: a takeover raises it, and lower ones are refused.
    """

    command: Annotated[Command, COMMAND]


@dataclass(frozen=True, kw_only=True)
class By:
    """The command that superseded another."""

    gs_session: Session
    seq: U32


@dataclass(frozen=True, kw_only=True)
class Said:
    """What a word says beside whose it is, and of which command."""

    session: Session
    relay_stamp: Stamp | None = None
    stamp: Stamp
    word: Word
    reason: Reason | None = None
    percent: Annotated[int, Integer(0, 100)] | None = None
    late_ms: Milliseconds | None = None
    by: By | None = None
    settled: bool | None = None
    beacon: BeaconMessage | None = None
    observed: bool | None = None


@dataclass(frozen=True, kw_only=True)
class ResultMessage(Said, AboutCommand):
    """One word about a command and a drone, on `…/droneY/commands_result/C`.

    `session` is the drone's, or the activator's where the activator closed the command; `stamp` is of the
    same clock, `relay_stamp` the activator's. `late_ms`: how far past the deadline the clock read after the
    write. `settled` marks the truth that came after an `unconfirmed`; `observed` false a `completed` whose effect
    nobody saw.
    """


@dataclass(frozen=True, kw_only=True)
class RosterEntry:
    """A drone that a broadcast concerns, and its session if it has one."""

    drone: DroneNumber
    session: Session | None = None


@dataclass(frozen=True, kw_only=True)
class _OfDrone:
    drone: DroneNumber


MOST_TOGETHER = 20
"""Words in one message, so that it stays below the longest payload with the longest reason in each, in JSON too."""


@dataclass(frozen=True, kw_only=True)
class WordTogether(Said, _OfDrone):
    """A drone's word among others about the same broadcast; behind its drone the fields of a result."""

    @classmethod
    def of(cls, drone: int, result: ResultMessage) -> Self:
        """The fields of a result, for a message that already has the command's id."""
        return cls(drone=drone, **{field.name: getattr(result, field.name) for field in fields(Said)})

    def result(self, about: AboutCommand) -> ResultMessage:
        """The word as a result of its own."""
        said = {field.name: getattr(self, field.name) for field in fields(Said)}
        return ResultMessage(gs_session=about.gs_session, seq=about.seq, **said)


@dataclass(frozen=True, kw_only=True)
class FogResultMessage(AboutCommand):
    """A broadcast's roster, words of its drones together, or why the fog denied a command.

    On `fogX/commands_result/C`.
    """

    session: Session
    stamp: Stamp
    roster: Annotated[tuple[RosterEntry, ...], Items(250)] | None = None
    denied: Reason | None = None
    beacon: BeaconMessage | None = None
    words: Annotated[tuple[WordTogether, ...], Items(MOST_TOGETHER)] | None = None


@dataclass(frozen=True, kw_only=True)
class Presence:
    """Birth (`up`) and will of a ground station (`gs/G/reachable`) or a UAV client (`droneY/reachable`).

    `revoked` is as in a beacon. `several` stands in the will of a connection beside which its client has another one.
    """

    version: Version = VERSION
    session: Session
    up: bool
    revoked: U32 | None = None
    several: bool | None = None


@dataclass(frozen=True, kw_only=True)
class FogPresence:
    """Birth and will of an activator (`fogX/reachable`): its fog broker's address, and its drones.

    `authenticated` says whether commands must be signed; `revoked` is as in a beacon.
    """

    version: Version = VERSION
    session: Session
    up: bool
    broker: Annotated[str, Text(200)] | None = None
    authenticated: bool | None = None
    drones: Annotated[tuple[RosterEntry, ...], Items(250)] | None = None
    revoked: U32 | None = None
