"""The clients at the sockets, and which of them controls which drone."""

from __future__ import annotations

from dataclasses import dataclass

from ..station.heard import Bell
from .endpoints import Peer

ALIVE_MS = 3000
"""How long a client counts as alive after a HEARTBEAT: three of one per second, as MAVSDK and QGroundControl send."""
REMEMBERED_MS = 30_000
"""How long a silent client keeps its claim to the drones that it controlled, should its HEARTBEAT return."""


@dataclass(frozen=True)
class Client:
    """A MAVLink node behind a socket; two sockets may have clients of one id."""

    peer: Peer
    system: int
    component: int

    def __str__(self) -> str:
        return f"system {self.system} at {self.peer.name}"


class Clients:
    """Clients by the time of their last HEARTBEAT. Times are milliseconds of the gateway's clock."""

    def __init__(self) -> None:
        self.controllers: dict[int, Client] = {}
        self._heard_ms: dict[Client, int] = {}
        self._bell = Bell()

    def on_heartbeat(self, client: Client, now_ms: int) -> None:
        self._heard_ms[client] = now_ms
        self._bell.ring()

    async def next_heartbeat(self, client: Client) -> None:
        """Return at a client's next HEARTBEAT; a cancellation ends this wait and no other one."""
        before = self._heard_ms.get(client)
        while self._heard_ms.get(client) in (None, before):
            await self._bell.wait()

    def forget(self, now_ms: int) -> None:
        """Drop the clients whose HEARTBEAT is older than REMEMBERED_MS."""
        self._heard_ms = {client: at for client, at in self._heard_ms.items() if now_ms - at <= REMEMBERED_MS}
        self.controllers = {drone: who for drone, who in self.controllers.items() if who in self._heard_ms}

    def is_known(self, client: Client) -> bool:
        """Whether it has sent a HEARTBEAT within REMEMBERED_MS."""
        return client in self._heard_ms

    def is_alive(self, client: Client, now_ms: int) -> bool:
        """Whether its HEARTBEAT is recent enough for it to keep control."""
        return now_ms - self._heard_ms.get(client, -ALIVE_MS - 1) <= ALIVE_MS

    def others_controller(self, drone: int, client: Client, now_ms: int) -> Client | None:
        """The other client that is alive and controls a drone; None if there is none."""
        controller = self.controllers.get(drone)
        is_other = controller is not None and controller != client and self.is_alive(controller, now_ms)
        return controller if is_other else None

    def on_gone(self, peer: Peer) -> None:
        """A socket was closed: its clients lose control."""
        self._heard_ms = {client: at_ms for client, at_ms in self._heard_ms.items() if client.peer is not peer}
        self.controllers = {drone: client for drone, client in self.controllers.items() if client.peer is not peer}
