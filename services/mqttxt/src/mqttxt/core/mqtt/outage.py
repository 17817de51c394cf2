"""What the log has of a connection that is down: each reason once, and that it is back, with how long it took."""

from __future__ import annotations

import logging

from ..address import BrokerAddress

logger = logging.getLogger("mqttxt.mqtt")

IN_VAIN_S = 2.0
"""A broker that accepted the last connection and was then of no use counts as back after so long."""


class Outage:
    """The times without a connection of the link `name` to `address`; times are seconds of the event loop's clock."""

    def __init__(self, name: str, address: BrokerAddress) -> None:
        self._where = (name, address)
        self._since_s: float | None = None
        self._failures = 0
        self._told: set[str] = set()
        self.patience_s = 0.0
        """How long a connection has to last before `end` is called."""

    def begin(self, now_s: float) -> None:
        """A connection that was of use is lost."""
        self._since_s = now_s
        logger.warning("%s: %s: connection lost; trying again", *self._where)

    def fail(self, reason: str, now_s: float, *, was_accepted: bool) -> None:
        """An attempt led to nothing, or to a connection that the broker ended with a reason."""
        self._since_s = now_s if self._since_s is None else self._since_s
        self._failures += 1
        self.patience_s = IN_VAIN_S if was_accepted else 0.0
        if reason not in self._told:
            self._told.add(reason)
            logger.warning("%s: %s: %s; trying again", *self._where, reason)

    def end(self, now_s: float) -> None:
        """There is a connection."""
        if self._since_s is None:
            logger.info("%s: connected to %s", *self._where)
        else:
            attempts = f", {self._failures} failed attempts" if self._failures > 1 else ""
            logger.info("%s: connected to %s after %.1f s%s", *self._where, now_s - self._since_s, attempts)
        self._since_s, self._failures, self.patience_s = None, 0, 0.0
        self._told.clear()
