"""MAVLink's parameter protocol with clients, answered from the gateway's copy (docs/gateway.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from ..drone.mavlink.autopilot import Autopilot
from ..drone.mavlink.autopilots import AUTOPILOTS
from ..drone.mavlink.parameter_protocol import HASH_CHECK
from ..errors import MqttxtError
from ..protocol.states import Airframe, Armed, Severity
from ..station.views import Drone
from .answers import TEXT_MS
from .clients import Client
from .parameter_copies import TAKEOFF_ALTITUDE, ParameterCopies, Shown
from .settings import NOT_THERE, ClientSettings, error_message
from .texts import send_text
from .translation import Declined
from .work import Work, Worker

MESSAGES: Final = frozenset({"PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"})
READ_S = 120.0
READINGS = 3
"""How often a set is read at most, if it changes while it is transferred."""
MOST_WAITING, MOST_LISTS = 256, 64
"""Limits of requests that wait for one drone's set, and of lists being sent; clients repeat what is lost."""
PER_TICK = 20
"""Parameters that all lists together send per tick: 400 per second, which fits every client's buffer."""


@dataclass(frozen=True)
class _Question:
    """A client's request for a parameter by its name or place; without both, for all."""

    client: Client
    name: str = ""
    place: int = -1

    @property
    def is_for_all(self) -> bool:
        return not self.name and self.place < 0


@dataclass
class _List:
    """A list that is being sent to a client, next at `place`. A value set meanwhile is sent as it is then."""

    shown: Shown
    place: int = 0


class ClientParameters(Worker):
    """The requests of all clients; reading from a drone is a task. Times are of the gateway's clock."""

    def __init__(self, work: Work, copies: ParameterCopies, settings: ClientSettings) -> None:
        super().__init__(work)
        self._copies = copies
        self._settings = settings
        self._waiting: dict[int, dict[_Question, None]] = {}
        self._lists: dict[tuple[Client, int], _List] = {}
        self._told_ms: dict[tuple[Client, int], int] = {}

    def on_message(self, client: Client, drone: Drone, message: Any) -> None:
        """Handle one of MESSAGES; it is ignored while the kind of the drone's autopilot is not known."""
        autopilot, kind = self._autopilot(drone), message.get_type()
        if autopilot is None:
            return
        if kind == "PARAM_REQUEST_LIST":
            self._ask(_Question(client), drone, autopilot)
        elif kind == "PARAM_SET" and message.param_id == HASH_CHECK:  # QGroundControl's sign that it has them already
            self._lists.pop((client, drone.number), None)
        elif kind == "PARAM_SET":
            self._settings.on_set(client, drone, autopilot, message)
        elif message.param_index >= 0:
            self._ask(_Question(client, place=message.param_index), drone, autopilot)
        elif message.param_id:
            self._ask(_Question(client, message.param_id), drone, autopilot)

    def tick(self, now_ms: int) -> None:
        """Send the next parameters of each list."""
        self._settings.tick(now_ms)
        self._told_ms = {told: at for told, at in self._told_ms.items() if now_ms - at < TEXT_MS}
        share = max(1, PER_TICK // max(1, len(self._lists)))
        for (client, drone), one in list(self._lists.items()):
            newest = self._copies.shown(drone, one.shown.autopilot)
            one.shown = newest if newest.has_places_of(one.shown) else one.shown
            end = min(one.place + share, len(one.shown))
            for place in range(one.place, end):
                client.peer.send(drone, one.shown.at(place))
            one.place = end
            if end == len(one.shown):
                del self._lists[client, drone]

    def _autopilot(self, drone: Drone) -> Autopilot | None:
        airframe = self._view(drone).get(Airframe)
        return None if airframe is None else AUTOPILOTS.get(airframe.autopilot)

    def _ask(self, question: _Question, drone: Drone, autopilot: Autopilot) -> None:
        """Answer at once if the set is known; else read it, once for all clients that ask meanwhile."""
        number, waiting = drone.number, self._waiting.get(drone.number)
        if question.name == TAKEOFF_ALTITUDE:
            question.client.peer.send(number, self._copies.message(number, autopilot, self._copies.own(number)))
        elif waiting is not None:
            if self._has_room(question.client, [other.client for other in waiting], MOST_WAITING):
                waiting[question] = None
        elif self._copies.is_fresh(number, self._now_ms()):
            self._answer(question, number, self._copies.shown(number, autopilot))
        else:
            self._waiting[number] = {question: None}
            self._group.create_task(self._read(drone, autopilot))

    async def _read(self, drone: Drone, autopilot: Autopilot) -> None:
        """Read the set from the drone, or the changes since the last reading, and answer the waiting clients."""
        error: Declined | MqttxtError | None = None
        try:
            async with self._control.reading(drone, self._view(drone).get(Armed)):
                await self._fetch(drone)
        except (Declined, MqttxtError) as why:
            error = why
        for question in self._waiting.pop(drone.number):
            if error is None:
                self._answer(question, drone.number, self._copies.shown(drone.number, autopilot))
            else:
                self._excuse(question, drone.number, autopilot, error)

    async def _fetch(self, drone: Drone) -> None:
        """Read until nothing changed during the transfer; a set that always changes counts for one answer."""
        for _ in range(READINGS):
            changes = self._copies.changes(drone.number)
            self._copies.begin(drone.number)
            found = await drone.parameters(self._copies.last(drone.number), timeout_s=READ_S)
            is_same = self._copies.changes(drone.number) == changes
            self._copies.put(drone.number, found, self._now_ms())
            if is_same:
                return
        self._copies.forget(drone.number)

    def _answer(self, question: _Question, drone: int, shown: Shown) -> None:
        client = question.client
        if question.is_for_all:
            if shown.hash is not None:
                client.peer.send(drone, shown.hash)
            self._begin_list(client, drone, shown)
            return
        if question.name == HASH_CHECK:
            found = shown.hash
        elif question.name:
            found = shown.named(question.name)
        else:
            found = shown.at(question.place) if question.place < len(shown) else None
        if found is None:
            found = error_message(client, question.name, question.place, NOT_THERE)
        client.peer.send(drone, found)

    def _excuse(self, question: _Question, drone: int, autopilot: Autopilot, why: Exception) -> None:
        """Answer with the gateway's own parameter alone: without any list QGroundControl loads nothing else either."""
        client = question.client
        if question.is_for_all:
            self._begin_list(client, drone, self._copies.own_alone(drone, autopilot))
        if (client, drone) not in self._told_ms:
            self._told_ms[client, drone] = self._now_ms()
            send_text(client.peer, drone, Severity.WARNING, f"parameters not read: {why}")

    def _begin_list(self, client: Client, drone: int, shown: Shown) -> None:
        others = [other for other, _ in self._lists]
        if (client, drone) in self._lists or self._has_room(client, others, MOST_LISTS):
            self._lists[client, drone] = _List(shown)

    def _has_room(self, client: Client, others: list[Client], most: int) -> bool:
        """Whether a client finds room beside others: who sends no HEARTBEAT takes none from who does."""
        is_known = self._control.knows(client)
        return sum(self._control.knows(other) == is_known for other in others) < most
