"""What a role asks of the world: the only way a state machine acts.

A runner (`mqttxt.io`) carries effects out in their order and reports back through the role's methods.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

from ..dialect.sources import Source
from ..messages import CommandId, Word
from ..readings import Reading, ReadingKey


@dataclass(frozen=True)
class Publish:
    """Publish on the connection `link`. With a `ref` the role hears how it ended (`on_published`)."""

    link: str
    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False
    expiry_s: int | None = None
    ref: Hashable = None


@dataclass(frozen=True)
class Subscribe:
    """Subscribe on `link`; `on_subscribed` with this effect follows the SUBACK.

    `live_only` is for commands: nothing retained is sent, and RETAIN shows as published (Retain Handling 2,
    Retain As Published).
    """

    link: str
    filters: tuple[str, ...]
    live_only: bool = False
    ref: Hashable = None


@dataclass(frozen=True)
class Unsubscribe:
    """Give up filters on `link`."""

    link: str
    filters: tuple[str, ...]


@dataclass(frozen=True)
class Transmit:
    """Write a MAVLink message to the autopilot, unless the session clock reads past `not_after_ms`.

    The runner checks the clock immediately before the write and reports `on_transmitted` with the clock's
    reading after it, or `on_refused`. `source`: in whose name.
    """

    message: Any
    not_after_ms: int | None = None
    ref: Hashable = None
    source: Source = Source.COMPANION


@dataclass(frozen=True)
class Journal:
    """Record durably, before the next effect, that a command is open or what its last word was.

    `word` None opens the id: `on_journalled` follows, or `on_not_journalled` where the disk did not take it. A last
    word is said whether or not the disk took it. `done`: it was delivered.
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
class Log:
    """Something to count under `kind`; the runner logs the first of a kind with its detail."""

    kind: str
    detail: str


@dataclass(frozen=True)
class Stop:
    """End the process: `reason` is for a person."""

    reason: str


Receipt = tuple[int, int]
"""Names an inbound message that waits for its PUBACK; opaque."""


@dataclass(frozen=True)
class StoreReading:
    """Store a reading durably; `on_stored` or `on_refused` follows, in the order of these effects."""

    reading: Reading
    receipt: Receipt | None = None


@dataclass(frozen=True)
class LoadReadings:
    """Load at most `most` stored readings behind the place `after`, oldest first; `on_loaded` follows."""

    after: int
    most: int


@dataclass(frozen=True)
class ForgetReadings:
    """Remove readings from the store: others have them."""

    keys: tuple[ReadingKey, ...]


@dataclass(frozen=True)
class Acknowledge:
    """Acknowledge an inbound message on `link`, in the order of receipt."""

    link: str
    receipt: Receipt


Effect = (
    Publish
    | Subscribe
    | Unsubscribe
    | Transmit
    | Journal
    | StoreReading
    | LoadReadings
    | ForgetReadings
    | Acknowledge
    | Log
    | Stop
)


@dataclass(frozen=True)
class Inbound:
    """A message received from a broker; with a `receipt` on a link that acknowledges by hand."""

    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False
    receipt: Receipt | None = None


@dataclass(frozen=True)
class Will:
    """The will of a connection: at QoS 1, retained."""

    topic: str
    payload: bytes
