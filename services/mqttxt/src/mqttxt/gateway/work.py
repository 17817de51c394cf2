"""What those parts of a gateway have in common that carry out what clients ask for."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from ..station.views import Drone
from .control import ClientControl
from .telemetry import View
from .translation import NOT_NOW, Declined


@dataclass(frozen=True)
class Work:
    """How the work for clients is done: by tasks of `group`, each command to start within `ttl_s` seconds.

    `view` returns what is known of a drone now, `now_ms` the time of the gateway's clock.
    """

    control: ClientControl
    view: Callable[[Drone], View]
    now_ms: Callable[[], int]
    group: asyncio.TaskGroup
    ttl_s: float


class Worker:
    """A part of a gateway that does such work."""

    def __init__(self, work: Work) -> None:
        self._control = work.control
        self._view = work.view
        self._now_ms = work.now_ms
        self._group = work.group
        self._ttl_s = work.ttl_s

    def _left_s(self, asked_ms: int, what: str = "") -> float:
        """The seconds that are left to start a command, waiting for control included; raises Declined when none is."""
        left_s = self._ttl_s - (self._now_ms() - asked_ms) / 1000
        if left_s <= 0:
            raise Declined(f"{what}no control in time, not sent", NOT_NOW)
        return left_s
