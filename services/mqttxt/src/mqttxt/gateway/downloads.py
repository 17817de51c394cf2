"""Plans from drones to clients: from the gateway's copy or, where there is none, from the drone."""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from ..errors import MqttxtError
from ..protocol.plans import PlanList
from ..protocol.states import Armed, Severity
from ..station.views import Drone
from .clients import Client
from .endpoints import Peer
from .plan_copies import PlanCopies
from .plan_items import Items, WrongItem, client_list, item_message
from .texts import send_text
from .translation import Declined
from .uploads import Uploads
from .work import Work, Worker

READ_S = 120.0
MOST_READINGS, MOST_WAITING = 64, 256
"""Limits of lists that clients behind one socket read, and of clients that wait for one drone's plan."""
KEPT_MS = 60_000
"""How long a client may pause in a list that it reads: longer than any client repeats a request for an item."""


@dataclass
class _Reading:
    """The list that one client reads, even if the drone's changes meanwhile."""

    items: Items
    asked_ms: int


@dataclass(frozen=True)
class _Asker:
    client: Client
    kind: PlanList


class Downloads(Worker):
    """The downloads of all clients; reading from a drone is a task."""

    def __init__(self, work: Work, copies: PlanCopies, uploads: Uploads) -> None:
        super().__init__(work)
        self._copies = copies
        self._uploads = uploads
        self._readings: dict[tuple[Client, int, PlanList], _Reading] = {}
        self._client_lists: dict[tuple[int, PlanList], Items] = {}
        self._askers: dict[int, set[_Asker]] = {}

    def on_list(self, client: Client, drone: Drone, kind: PlanList) -> None:
        """MISSION_REQUEST_LIST: send the count, at once if the list is known; a client that asks again waits on."""
        asker, waiting = _Asker(client, kind), self._askers.get(drone.number)
        if waiting is not None:
            if len(waiting) < MOST_WAITING:
                waiting.add(asker)
        elif self._copies.get(drone.number, kind) is None or self._uploads.is_pending(drone.number):
            self._askers[drone.number] = {asker}
            self._group.create_task(self._read(drone))
        else:
            self._answer(asker, drone)

    def on_request(self, client: Client, drone: Drone, kind: PlanList, seq: int, as_int: bool) -> None:
        """MISSION_REQUEST_INT or MISSION_REQUEST: send the item of the list whose count the client got."""
        reading = self._readings.get((client, drone.number, kind))
        if reading is None or seq >= len(reading.items):
            _acknowledge(client, drone, kind, mavlink.MAV_MISSION_INVALID_SEQUENCE)
            return
        reading.asked_ms = self._now_ms()
        target = (client.system, client.component)
        client.peer.send(drone.number, item_message(reading.items[seq], target, seq, kind, as_int))

    def tick(self, now_ms: int) -> None:
        """Drop the lists that their clients no longer read."""
        self._readings = {key: one for key, one in self._readings.items() if now_ms - one.asked_ms <= KEPT_MS}

    async def _read(self, drone: Drone) -> None:
        """Answer the waiting clients after pending uploads; lists that are not known are read from the drone."""
        error: Declined | MqttxtError | None = None
        try:
            await self._uploads.settled(drone.number)
            if any(self._copies.get(drone.number, asker.kind) is None for asker in self._askers[drone.number]):
                async with self._control.reading(drone, self._view(drone).get(Armed)):
                    plan = await drone.download(timeout_s=READ_S)
                self._copies.put(drone.number, plan.content.lists)
        except (Declined, MqttxtError) as found:
            error = found
        for asker in self._askers.pop(drone.number):
            if error is None:
                self._answer(asker, drone)
            else:
                _refuse(asker, drone, error)

    def _answer(self, asker: _Asker, drone: Drone) -> None:
        """Send the count of a known list; by it the client learns what the drone has, which settles a failed upload."""
        client, kind = asker.client, asker.kind
        known = self._copies.get(drone.number, kind) or ()
        try:
            items = client_list(known, kind, self._view(drone))
        except WrongItem as unknown:
            _refuse(asker, drone, unknown)
            return
        if self._client_lists.get((drone.number, kind)) != items:
            self._client_lists[drone.number, kind] = items
        self._make_room(client.peer)
        self._readings[client, drone.number, kind] = _Reading(self._client_lists[drone.number, kind], self._now_ms())
        if kind is PlanList.MISSION:
            self._copies.name(client, drone.number, known)
        self._uploads.forgive(client, drone.number, kind)
        count = mavlink.MAVLink_mission_count_message(client.system, client.component, len(items), kind)
        client.peer.send(drone.number, count)

    def _make_room(self, peer: Peer) -> None:
        """Drop the list that rests longest of the many that are read behind one socket."""
        there = [key for key in self._readings if key[0].peer is peer]
        if len(there) >= MOST_READINGS:
            del self._readings[min(there, key=lambda key: self._readings[key].asked_ms)]


def _refuse(asker: _Asker, drone: Drone, error: Declined | MqttxtError | WrongItem) -> None:
    result = mavlink.MAV_MISSION_DENIED if isinstance(error, Declined) else mavlink.MAV_MISSION_ERROR
    _acknowledge(asker.client, drone, asker.kind, result)
    send_text(asker.client.peer, drone.number, Severity.WARNING, f"{asker.kind.label} not read: {error}")


def _acknowledge(client: Client, drone: Drone, kind: int, result: int) -> None:
    ack = mavlink.MAVLink_mission_ack_message(client.system, client.component, result, kind)
    client.peer.send(drone.number, ack)
