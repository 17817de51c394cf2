"""Effects: the actions that a role requests. A state machine acts in no other way.

A runner (`mqttxt.core.runner`) carries effects out in their order and reports back through the role's methods.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass


@dataclass(slots=True, unsafe_hash=True)
class Publish:
    """Publish on the connection `link`; with a `ref`, its outcome is reported to the role (`on_published`).

    `everywhere`: over each connection of a link that has several (`core.bond`). It is never changed, but not frozen
    either: that would cost 2.5 µs per relayed state, and as much again for `Inbound`.
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

    `live_only` is for commands: the broker sends no retained message, and leaves RETAIN as it was published (Retain
    Handling 2, Retain As Published).
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
    """Give up the connection `link`, so that its will is sent, and open a new one; `reason` is for a person."""

    link: str
    reason: str


@dataclass(frozen=True)
class Log:
    """An event to count under `kind`; the runner logs the first of each kind with its detail."""

    kind: str
    detail: str


@dataclass(frozen=True)
class Stop:
    """End the process: `reason` is for a person."""

    reason: str


@dataclass(frozen=True)
class Audit:
    """Write `message`, of the session time `now_ms`, into the audit log, if the node has one (R14.2).

    The `event` is `command` or `select` for an admitted one, `word` for a last word. `who` is the name of its sender,
    as in the certificate, None if unknown; `is_signed`: proven by a signature. `drone` is None for the whole fog.
    """

    event: str
    message: object
    now_ms: int
    who: str | None
    drone: int | None
    is_signed: bool


Receipt = tuple[int, int]
"""Identifies an inbound message that waits for its PUBACK; opaque."""


Effect = Publish | Subscribe | Unsubscribe | Reconnect | Log | Stop | Audit


@dataclass(slots=True, unsafe_hash=True)
class Inbound:
    """A message received from a broker; it has a `receipt` on a link whose role acknowledges messages itself.

    `path` is the connection over which it arrived, of a link that has several.
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
