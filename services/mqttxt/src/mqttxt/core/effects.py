"""What a role asks of the world: the only way a state machine acts.

A runner (`mqttxt.core.runner`) carries effects out in their order and reports back through the role's methods.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass


@dataclass(slots=True, unsafe_hash=True)
class Publish:
    """Publish on the connection `link`. With a `ref` the role hears how it ended (`on_published`).

    `everywhere`: over each connection of a link that has several (`core.bond`). Nobody changes one; to be frozen would
    cost 2.5 µs of each state that is relayed, and as much for `Inbound`.
    """

    link: str
    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False
    expiry_s: int | None = None
    ref: Hashable = None
    everywhere: bool = False


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
class Reconnect:
    """Give up the connection `link`, with its will, and begin another one: `reason` is for a person."""

    link: str
    reason: str


@dataclass(frozen=True)
class Log:
    """Something to count under `kind`; the runner logs the first of a kind with its detail."""

    kind: str
    detail: str


@dataclass(frozen=True)
class Stop:
    """End the process: `reason` is for a person."""

    reason: str


@dataclass(frozen=True)
class Audit:
    """Write into the audit log, where there is one, what was said at `now_ms` of the session's clock.

    A `command` or `select` was admitted; a `word` is a last one. `who` is the node that said it, as certificates name
    it, None where that is not known; `is_signed`: its signature says so. `drone` None: it is of the fog as a whole.
    """

    event: str
    message: object
    now_ms: int
    who: str | None
    drone: int | None
    is_signed: bool


Receipt = tuple[int, int]
"""Names an inbound message that waits for its PUBACK; opaque."""


Effect = Publish | Subscribe | Unsubscribe | Reconnect | Log | Stop | Audit


@dataclass(slots=True, unsafe_hash=True)
class Inbound:
    """A message received from a broker; with a `receipt` on a link that acknowledges by hand.

    `path` is the connection it came by, of a link that has several.
    """

    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False
    receipt: Receipt | None = None
    path: str = ""


@dataclass(frozen=True)
class Will:
    """The will of a connection: at QoS 1, retained."""

    topic: str
    payload: bytes
