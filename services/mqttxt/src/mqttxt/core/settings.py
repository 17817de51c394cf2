"""Settings, waiting times and retries that the roles share."""

from __future__ import annotations

from dataclasses import dataclass

from ..protocol.values import Encoding
from .clock import BEACON_INTERVAL_MS

CONNECT_S = 30.0
"""How long a station waits for an activator; connecting, subscribing and registering take one or two round trips each.
"""
GRACE_MS = 5_000
"""How long after deadline and limit a last word may still arrive before the command is `unconfirmed` (R5.9)."""
REBIRTH_MS = 1_000
"""How long an owner waits before it corrects its retained topic, so that two owners do not race."""
QUERY_DEADLINE_MS = 0
"""A deadline that is always past: it asks for the outcome of a command that an earlier session may have forwarded."""
RESEND_FIRST_MS = 2_000
RESEND_LAST_MS = 16_000
TOGETHER_MS = 1_000
"""How long at most the roster and the words of a broadcast wait for each other at the activator. Drones confirm by
heartbeats, one per second, and nobody acts on the confirmation of some of the drones alone."""
NO_MATCHING_SUBSCRIBERS = 0x10
"""MQTT 5 PUBACK reason code: the broker accepted the message, and no client subscribes to it."""


@dataclass(frozen=True)
class Settings:
    """A role's settings. `qos` is that of commands, results and the like; states are QoS 0, presence and leases QoS 1.

    `bundles`: a UAV client publishes its states together, once per `bundle_ms`, and so does an activator for the
    stations that ask for it; for these, words of a broadcast are sent together too. PSMI and QoDS leave out drones
    whose figures are older than `state_limit_ms`.
    """

    qos: int = 1
    encoding: Encoding = Encoding.CBOR
    beacon_interval_ms: int = BEACON_INTERVAL_MS
    bundles: bool = False
    bundle_ms: int = 1000
    state_limit_ms: int = 45_000


def next_turn_ms(due_ms: int, now_ms: int, interval_ms: int) -> int:
    """Next time of a task that was due at `due_ms`: on the same schedule, unless it ran early or missed a turn."""
    on_schedule = due_ms <= now_ms < due_ms + interval_ms
    return (due_ms if on_schedule else now_ms) + interval_ms


class Rebirth:
    """The time to correct an owner's retained topic. Once armed, nothing postpones it: a stranger may go on writing."""

    def __init__(self) -> None:
        self._at_ms: int | None = None

    def arm(self, now_ms: int) -> None:
        if self._at_ms is None:
            self._at_ms = now_ms + REBIRTH_MS

    def disarm(self) -> None:
        self._at_ms = None

    def is_due(self, now_ms: int) -> bool:
        """Whether it is time; if so, disarms."""
        if self._at_ms is None or now_ms < self._at_ms:
            return False
        self._at_ms = None
        return True


class Retry:
    """When to send an unanswered message again: pauses double from two to sixteen seconds."""

    def __init__(self, first_ms: int, gap_ms: int = RESEND_FIRST_MS) -> None:
        self._gap_ms = gap_ms
        self._next_ms = first_ms

    def is_due(self, now_ms: int) -> bool:
        """Whether it is time; if so, sets the next time."""
        if now_ms < self._next_ms:
            return False
        self._next_ms = now_ms + self._gap_ms
        self._gap_ms = min(2 * self._gap_ms, RESEND_LAST_MS)
        return True

    @classmethod
    def unanswered(cls, now_ms: int) -> Retry:
        """For a message sent just now: it is sent again after two seconds."""
        retry = cls(now_ms)
        retry.is_due(now_ms)
        return retry

    @classmethod
    def after_word(cls, qos: int, now_ms: int) -> Retry | None:
        """For a command that has a first word: asked for every 16 s at QoS 0, not at all at QoS 1."""
        return cls(now_ms + RESEND_LAST_MS, RESEND_LAST_MS) if qos == 0 else None

    @classmethod
    def of(cls, qos: int, now_ms: int, remaining_ms: int, waits_ms: int = 0) -> Retry:
        """For an unanswered command: sent again after two seconds; at QoS 1, where MQTT repeats it, after the deadline.

        `waits_ms`: how long the receiver may hold back its answer.
        """
        if qos == 0:
            return cls(now_ms + RESEND_FIRST_MS + waits_ms, 2 * RESEND_FIRST_MS)
        return cls(now_ms + max(RESEND_FIRST_MS, remaining_ms))
