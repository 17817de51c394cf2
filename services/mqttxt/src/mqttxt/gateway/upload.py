"""One list of a plan, as a client uploads it item by item (docs/gateway.md)."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..protocol.plans import PlanList
from ..protocol.states import Severity
from ..station.views import Drone
from .clients import Client
from .texts import send_text


@dataclass(eq=False)
class Upload:
    """One list from one client. `before`: how many items precede the plan's own. `is_begun`: it is being sent."""

    client: Client
    drone: Drone
    kind: PlanList
    count: int
    heard_ms: int
    before: int = 0
    asked_ms: int = 0
    received: int = 0
    items: list[Any] = field(default_factory=list)
    task: asyncio.Task[None] | None = None
    whole: asyncio.Event = field(default_factory=asyncio.Event)
    ack_ms: int = 0
    is_acked: bool = False
    is_over: bool = False
    is_begun: bool = False
    is_asking: bool = False

    @property
    def is_received(self) -> bool:
        return self.whole.is_set()

    def acknowledge(self, result: int) -> None:
        """Send MISSION_ACK, once."""
        if not self.is_acked:
            self.is_acked = True
            client = self.client
            ack = mavlink.MAVLink_mission_ack_message(client.system, client.component, result, self.kind)
            client.peer.send(self.drone.number, ack)

    def ask(self, now_ms: int) -> None:
        """Ask for the next item."""
        self.is_asking, self.asked_ms = True, now_ms
        client = self.client
        request = mavlink.MAVLink_mission_request_int_message(client.system, client.component, self.received, self.kind)
        client.peer.send(self.drone.number, request)

    def say(self, severity: Severity, text: str) -> None:
        send_text(self.client.peer, self.drone.number, severity, text)
