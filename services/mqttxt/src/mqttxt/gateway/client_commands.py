"""A client's command from its first COMMAND_ACK to its last, and how repetitions of it are recognised."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from ..core.ledger import OVERRIDING
from ..errors import BrokerRefused, ConfigurationError, FogUnreachable, PayloadError, StationEnded
from ..protocol.commands import Command, Disarm, Hold, Resume, StartMission, Stream
from ..protocol.messages import Word
from ..protocol.states import Severity
from ..station.outcomes import Outcome
from .answers import ACCEPTED
from .clients import Client
from .texts import send_text
from .translation import CANCELLED, DENIED, NOT_NOW, UNSUPPORTED, Declined, Request

IN_PROGRESS, FAILED = int(mavlink.MAV_RESULT_IN_PROGRESS), int(mavlink.MAV_RESULT_FAILED)
PERCENT_UNKNOWN = 255
FIRST_PROGRESS_MS, PROGRESS_MS = 400, 1000
"""MAVSDK repeats after 500 ms without an answer, and gives up after 3 s without a newer one, as QGroundControl does."""
MODE_PATIENCE_MS = 1700
"""How long a change of mode may wait for a plan: MAVSDK takes silence for an error after 2 s."""
GROUND_HOLD_MS = 1000
"""How long a disarmed drone may take to accept HOLD before its client gets ACCEPTED anyway.

MAVSDK's `arm()` enters HOLD first where the drone was in a mission or returned. For a HOLD that is not accepted within
2 s it reports two results, the hold's and the arm's, and writes the second to a call that has returned.
"""
REPEAT_MS, NUMBERED_REPEAT_MS = 1000, 10_000
"""How long after its end a command counts as repeated; the latter where `confirmation` marks a repetition, and then
also after its newest repetition."""

STOPPING: Final = (*OVERRIDING, Disarm)

RESULTS: Final[dict[Word, int | None]] = {
    Word.COMPLETED: ACCEPTED,
    Word.DENIED: DENIED,
    Word.UNSUPPORTED: UNSUPPORTED,
    Word.FAILED: FAILED,
    Word.EXPIRED: NOT_NOW,
    Word.UNREACHABLE: NOT_NOW,
    Word.OVERTAKEN: CANCELLED,
    Word.SUPERSEDED: CANCELLED,
    Word.UNCONFIRMED: None,  # the outcome is unknown, and any result would say more than the client's own time-out
}
SEVERITIES: Final = {Word.COMPLETED: Severity.INFO, Word.SUPERSEDED: Severity.NOTICE}


def is_quiet(request: Request, command: Command) -> bool:
    """Whether a command never gets IN_PROGRESS: MAVSDK's library does not survive that for these modes.

    `start_mission()` and `pause_mission()` take the first word as their result, even IN_PROGRESS, and write the next
    one to a call that has returned. An `arm()` that enters HOLD first reports failure by it, and arms.
    """
    return request.mav_cmd == mavlink.MAV_CMD_DO_SET_MODE and isinstance(command, Hold | StartMission | Resume)


@dataclass
class ClientCommand:
    """A command of a client; `result` is None until the final acknowledgement, for which it `waits`.

    `place`: its number among all commands, in the order in which clients sent them. `confirmation`: that of the
    first message. `command`: what it means, None if it means nothing. `is_quiet`: it gets no IN_PROGRESS.
    `is_declined`: it got a definite no. `is_kept`: it waits until the drone has its client's plan. `ground_hold`:
    for a HOLD before arming, the future of whether the drone accepts it. `repeated_ms`: when its newest repetition
    came.
    """

    client: Client
    drone: int
    request: Request
    asked_ms: int
    next_progress_ms: int
    place: int
    confirmation: int
    command: Command | None = None
    is_quiet: bool = False
    percent: int = PERCENT_UNKNOWN
    result: int | None = None
    waits: bool = True
    is_answered: bool = False
    is_kept: bool = False
    is_declined: bool = False
    ground_hold: asyncio.Future[bool] | None = None
    ended_ms: int = 0
    repeated_ms: int = 0

    def repeat(self, now_ms: int) -> None:
        """Repeat its acknowledgement."""
        self.repeated_ms = now_ms
        if self.waits:
            self.progress()
        elif self.result is not None:
            self.acknowledge(self.result)

    def progress(self) -> None:
        """Send IN_PROGRESS, unless the command is quiet."""
        if not self.is_quiet:
            self.acknowledge(IN_PROGRESS, self.percent)

    def is_repeated(self, confirmation: int, newest: ClientCommand, now_ms: int) -> bool:
        """Whether an equal request of its client is a repetition; `newest` is what that client asked for last.

        A client that numbers its repetitions changes `confirmation`. Another one may always send the same number. Then
        an open stop behind a command that flies on is meant anew, and a hold behind anything: the drone stops at worst.
        """
        if confirmation and confirmation != self.confirmation:
            return not self.is_past(now_ms)
        if newest is self:
            return self.waits or (not self.is_declined and now_ms - self.ended_ms <= REPEAT_MS)
        stops_anew = isinstance(self.command, Hold) or not isinstance(newest.command, STOPPING)
        return self.waits and not (isinstance(self.command, STOPPING) and stops_anew)

    def is_past(self, now_ms: int) -> bool:
        """Whether no repetition of it comes any more."""
        return not self.waits and now_ms - max(self.ended_ms, self.repeated_ms) > NUMBERED_REPEAT_MS

    def hear(self, command: Command, outcome: Outcome, now_ms: int) -> None:
        """Take a word of the drone about it."""
        self.is_answered = True
        if outcome.word is Word.ACCEPTED or outcome.completed:
            self.settle(True)
        if outcome.word is Word.IN_PROGRESS:
            self.percent = PERCENT_UNKNOWN if outcome.percent is None else outcome.percent
        elif outcome.word is Word.ACCEPTED:
            self.end(ACCEPTED, now_ms)
        elif outcome.is_last:
            result = None if outcome.is_of_activator else RESULTS[outcome.word]
            self.end(result, now_ms)
            if not (isinstance(command, Stream) and outcome.completed):
                severity = Severity.CRITICAL if result is None else SEVERITIES.get(outcome.word, Severity.WARNING)
                send_text(self.client.peer, self.drone, severity, text_of(outcome))

    def decline(self, declined: Declined, now_ms: int) -> None:
        """Send a definite no, once."""
        if self.is_declined:
            return
        self.is_declined = True
        self.end(declined.result, now_ms)
        send_text(self.client.peer, self.drone, Severity.WARNING, str(declined))

    def end(self, result: int | None, now_ms: int) -> None:
        """Send the final acknowledgement, once; with None as result it gets none."""
        if not self.waits:
            return
        self.waits, self.result, self.ended_ms = False, result, now_ms
        if result is not None:
            self.acknowledge(result)

    def settle(self, is_accepted: bool) -> None:
        """Note, once, whether the drone accepted a HOLD before arming."""
        if self.ground_hold is not None and not self.ground_hold.done():
            self.ground_hold.set_result(is_accepted)

    def acknowledge(self, result: int, percent: int = 0) -> None:
        """Send COMMAND_ACK."""
        acknowledge(self.client, self.drone, self.request, result, percent)


@contextlib.contextmanager
def declining(entry: ClientCommand, now_ms: Callable[[], int]) -> Iterator[None]:
    """Answer an error that prevents sending by a definite no; where the station ends the outcome is not known."""
    try:
        yield
    except Declined as declined:
        entry.decline(declined, now_ms())
    except FogUnreachable as error:
        entry.decline(Declined(str(error), NOT_NOW), now_ms())
    except (ConfigurationError, PayloadError) as error:
        entry.decline(Declined(str(error)), now_ms())
    except (StationEnded, BrokerRefused):
        entry.end(None, now_ms())


def text_of(outcome: Outcome) -> str:
    """An outcome as a text of its drone, whose number it therefore leaves out."""
    return str(replace(outcome, superseded_by=None)).removeprefix(f"drone {outcome.drone}: ")


def acknowledge(client: Client, drone: int, request: Request, result: int, percent: int = 0) -> None:
    """Send COMMAND_ACK to the client that asked, and to no other; a request that was a message of its own gets none."""
    if request.is_message:
        return
    ack = mavlink.MAVLink_command_ack_message(
        command=request.mav_cmd,
        result=result,
        progress=percent,
        result_param2=0,
        target_system=client.system,
        target_component=client.component,
    )
    client.peer.send(drone, ack)
