"""Logs the outages of a connection: each reason once, and the reconnection with the length of the outage."""

from __future__ import annotations

import logging

from ..address import BrokerAddress

logger = logging.getLogger("mqttxt.mqtt")

IN_VAIN_S = 2.0
"""After a connection that was accepted and of no use, the next one must last this long to count as back."""


class Outage:
    """The outages of the link `name` to `address`; times are seconds of the event loop's clock."""

    def __init__(self, name: str, address: BrokerAddress) -> None:
        self._name = name
        self._address = address
        self._since_s: float | None = None
        self._failures = 0
        self._told: set[str] = set()
        self.patience_s = 0.0
        """How long a connection has to last before its link calls `end`."""

    def begin(self, now_s: float) -> None:
        """A working connection is lost."""
        self._since_s = now_s
        logger.warning("%s: %s: connection lost; trying again", self._name, self._address)

    def fail(self, reason: str, now_s: float, *, was_accepted: bool) -> None:
        """An attempt failed, or its connection was of no use; `was_accepted`: the broker had accepted it."""
        self._since_s = now_s if self._since_s is None else self._since_s
        self._failures += 1
        self.patience_s = IN_VAIN_S if was_accepted else 0.0
        if reason not in self._told:
            self._told.add(reason)
            logger.warning("%s: %s: %s; trying again", self._name, self._address, reason)

    def end(self, now_s: float) -> None:
        """The connection is up."""
        if self._since_s is None:
            logger.info("%s: connected to %s", self._name, self._address)
        else:
            attempts = f", {self._failures} failed attempts" if self._failures > 1 else ""
            after_s = now_s - self._since_s
            logger.info("%s: connected to %s after %.1f s%s", self._name, self._address, after_s, attempts)
        self._since_s, self._failures, self.patience_s = None, 0, 0.0
        self._told.clear()
