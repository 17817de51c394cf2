"""Which client controls which drone, and thereby which drones this station controls (docs/gateway.md)."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import defaultdict
from collections.abc import AsyncIterator, Callable

from ..protocol.states import Armed, Severity
from ..station.ground_station import GroundStation
from ..station.views import Drone
from .clients import Client, Clients
from .texts import send_text
from .translation import CANCELLED, NOT_NOW, Declined

HEARTBEAT_S = 2.0
"""How long a command waits for its client's HEARTBEAT: MAVSDK may send that up to 1 s after its first command."""
READING_S = 10.0


class ClientControl:
    """Clients' control of drones; with `take_over` any client that commands takes it. Times: the gateway's clock."""

    def __init__(self, station: GroundStation, clients: Clients, now_ms: Callable[[], int], take_over: bool) -> None:
        self._station = station
        self._clients = clients
        self._now_ms = now_ms
        self._take_over = take_over
        self._read: defaultdict[int, set[object]] = defaultdict(set)
        self._taken_ms: dict[int, int] = {}

    async def heard(self, client: Client) -> None:
        """Wait for a HEARTBEAT of a client that is not alive; raises Declined without one."""
        if self._clients.is_alive(client, self._now_ms()):
            return
        try:
            async with asyncio.timeout(HEARTBEAT_S):
                await self._clients.next_heartbeat(client)
        except TimeoutError:
            raise Declined(f"no HEARTBEAT from system {client.system}: only who sends them controls") from None

    def knows(self, client: Client) -> bool:
        """Whether a client sends HEARTBEATs, or did within the last half minute."""
        return self._clients.is_known(client)

    def check(self, client: Client, drone: Drone, asked_ms: float = math.inf) -> None:
        """Raises Declined if a client may not command a drone, or if a station took the drone after it asked."""
        if asked_ms <= self._taken_ms.get(drone.number, -1):
            raise Declined("given up: another station took the drone")
        other = self._other(client, drone)
        if other is not None and not self._take_over:
            raise Declined(f"controlled by {other}")

    def has(self, client: Client, drone: Drone) -> bool:
        """Whether a client has control of a drone: no other has taken it since."""
        return self._clients.controllers.get(drone.number) == client

    @contextlib.asynccontextmanager
    async def reading(self, drone: Drone, armed: Armed | None) -> AsyncIterator[None]:
        """Have control of a drone while something is read from it; raises Declined.

        Without a controlling client it is taken on the ground only: in the air the autopilot must notice that no client
        is left. For the reading it is held at most until a client takes it.
        """
        readers, reader = self._read[drone.number], object()
        try:
            if not drone.is_controlled or readers:
                if armed != Armed(False):
                    raise Declined("nobody controls the drone, and it is not known to be disarmed")
                readers.add(reader)
                drone.claim()
                await self._granted(drone, READING_S)
            yield
        finally:
            readers.discard(reader)
            self.review(drone, armed)

    async def take(self, client: Client, drone: Drone, left_s: float) -> None:
        """Get control of a drone for a client, within `left_s` seconds.

        Raises Declined, also if another client took the drone meanwhile, and what `Drone.claim` and `Drone.take_over`
        raise.
        """
        self._hand(client, drone)
        if drone.is_controlled:
            return
        drone.claim()
        if self._take_over and self._is_others(drone):
            await drone.take_over(left_s)
        else:
            await self._granted(drone, left_s)
        if not self.has(client, drone):
            raise Declined("given up: its client has lost control", CANCELLED)

    async def take_over(self, client: Client, drone: Drone, left_s: float) -> None:
        """Take control for a client from any holder. Errors as `take`."""
        if not drone.is_controlled:
            drone.claim()
            await drone.take_over(left_s)
        self._hand(client, drone)

    def give_up(self, client: Client, drone: Drone) -> None:
        """A client gives up control."""
        if self._clients.controllers.get(drone.number) == client:
            self._give_up(drone)

    def review(self, drone: Drone, armed: Armed | None) -> None:
        """Claim a drone while its controlling client is alive, or for a reading on the ground; else release it."""
        if armed != Armed(False):
            self._read[drone.number].clear()
        controller = self._clients.controllers.get(drone.number)
        is_alive = controller is not None and self._clients.is_alive(controller, self._now_ms())
        if is_alive or self._read[drone.number]:
            drone.claim()
        else:
            drone.release()

    def on_taken(self, drone: Drone, holder: str) -> None:
        """Another station controls a drone now: its client gets a text, and does not regain control by waiting."""
        self._taken_ms[drone.number] = self._now_ms()
        controller = self._clients.controllers.get(drone.number)
        if controller is not None:
            self._give_up(drone)
            send_text(controller.peer, drone.number, Severity.WARNING, f"control was taken by the station {holder}")

    async def _granted(self, drone: Drone, left_s: float) -> None:
        """Wait for control that was claimed; raises Declined."""
        try:
            await self._station.wait_until(lambda: drone.is_controlled or self._is_others(drone), left_s)
        except TimeoutError:
            raise Declined("no control: the fog did not answer in time", NOT_NOW) from None
        if not drone.is_controlled:
            holder = drone.holder
            self._give_up(drone)
            raise Declined(f"controlled by the station {holder}")

    def _hand(self, client: Client, drone: Drone) -> None:
        """Give a client control here; another one that had it gets a text."""
        other = self._other(client, drone)
        self._clients.controllers[drone.number] = client
        self._read[drone.number].clear()
        if other is not None:
            send_text(other.peer, drone.number, Severity.WARNING, f"control was taken by {client}")

    def _is_others(self, drone: Drone) -> bool:
        return drone.holder not in (None, self._station.name)

    def _other(self, client: Client, drone: Drone) -> Client | None:
        return self._clients.others_controller(drone.number, client, self._now_ms())

    def _give_up(self, drone: Drone) -> None:
        self._clients.controllers.pop(drone.number, None)
        drone.release()
