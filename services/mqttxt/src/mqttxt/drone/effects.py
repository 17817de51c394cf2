"""The effects that only a UAV client has: on its autopilot, its journal, its store of readings and its logs."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

from ..core import effects
from ..core.effects import Receipt
from ..protocol.messages import CommandId, Word
from ..protocol.readings import Reading, ReadingKey
from .log_work import LogWork
from .mavlink.sources import Source


@dataclass(frozen=True)
class Transmit:
    """Write a MAVLink message to the autopilot, unless the session clock reads past `not_after_ms`.

    The runner checks the clock immediately before the write. With a `ref` it reports `on_transmitted`, with the clock's
    reading after the write, or `on_refused`. `source`: the sender that the message names.
    """

    message: Any
    not_after_ms: int | None = None
    ref: Hashable = None
    source: Source = Source.COMPANION


@dataclass(frozen=True)
class Journal:
    """Record durably, before the next effect, that a command is open or what its last word was.

    `word` None opens the id: `on_journalled` follows, or `on_not_journalled` if the write failed. A last word is
    published even if its write failed. `done`: it was delivered.
    """

    id: CommandId
    command: str
    word: Word | None = None
    reason: str | None = None
    done: bool = False

    @property
    def is_opening(self) -> bool:
        return self.word is None and not self.done


@dataclass(frozen=True)
class StoreReading:
    """Store a reading durably; `on_stored` or `on_refused` follows, in the order of these effects."""

    reading: Reading
    receipt: Receipt | None = None


@dataclass(frozen=True)
class LoadReadings:
    """Load at most `most` stored readings after the place `after`, oldest first; `on_loaded` follows."""

    after: int
    most: int


@dataclass(frozen=True)
class ForgetReadings:
    """Remove readings from the store, because they were delivered."""

    keys: tuple[ReadingKey, ...]


@dataclass(frozen=True)
class Acknowledge:
    """Acknowledge an inbound message on `link`, in the order of receipt."""

    link: str
    receipt: Receipt


@dataclass(frozen=True)
class Led:
    """The connection `path` leads to the activator: it delivered `proof`, which arrives over each one that does."""

    path: str
    proof: Hashable


Effect = (
    effects.Effect | Transmit | Journal | StoreReading | LoadReadings | ForgetReadings | Acknowledge | Led | LogWork
)
