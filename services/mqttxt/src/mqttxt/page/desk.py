"""The commands that the page has sent, with every word about them; a watch-only page has no desk."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable, Coroutine, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ..core.printable import printable
from ..errors import ConfigurationError, FogUnreachable, MqttxtError
from ..protocol.codec import layout_of
from ..protocol.commands import Command, Goto, Resume, StartMission, UploadPlan
from ..protocol.messages import CommandId
from ..protocol.names import in_fleet
from ..station.fleets import Fleets
from ..station.ground_station import GroundStation
from ..station.heard import SentCommand
from ..station.outcomes import Event, Outcome, PsmiList
from ..station.plan import Plan
from ..station.views import CARRIED_S, Drone, Fog
from .drafts import path_of
from .event_log import EventLog
from .offers import DroneKey, FogKey, MissionRequest, Request, TakeOverRequest, Target, UploadRequest
from .places import Place
from .words import choice_in_plain_english, code_of, headline, in_plain_english

KEPT = 200
"""The number of commands that the page shows."""
_UNITS = {"altitude_m": " m", "latitude_deg": "°", "longitude_deg": "°"}


@dataclass
class Order:
    """One request that was carried out, with its addressees and the words about it in their order."""

    number: int
    text: str
    ttl_s: float
    limit_s: float
    sent_s: float
    """The time of sending, in seconds of the event loop's clock."""
    choice: Command | None = None
    """The command for whoever arrives first."""
    goal: tuple[float, float] | None = None
    """The destination, in degrees north and east."""
    path: list[tuple[float, float]] | None = None
    """For an upload: the positions of its mission, in degrees north and east."""
    progress: str | None = None
    """For an upload: its progress."""
    words: list[dict[str, Any]] = field(default_factory=list)
    waiting: int = 0
    """The number of its parts without a last word."""

    def as_plain(self, now_s: float) -> dict[str, Any]:
        """The order as the browser gets it. Times are durations, because the browser's clock differs."""
        return {
            "number": self.number,
            "text": self.text,
            "start_left_ms": round((self.sent_s + self.ttl_s - now_s) * 1000),
            "end_left_ms": round((self.sent_s + self.ttl_s + self.limit_s - now_s) * 1000),
            "goal": self.goal,
            "path": self.path,
            "progress": self.progress,
            "words": self.words,
            "open": self.waiting > 0,
        }


class OrderDesk:
    """Sends the commands that pages request.

    Parameters:
        station: an entered station that wants control, or several as one.
        fogs: the fogs that it is connected to.
        log: the log in which sent commands are entered.
        group: the group of the tasks that follow the commands.
        changed: called with an order whenever it has changed.
        places: the named places; a command that goes to one shows its name.
    """

    def __init__(
        self,
        station: GroundStation | Fleets,
        fogs: Iterable[Fog],
        log: EventLog,
        group: asyncio.TaskGroup,
        changed: Callable[[Order], None],
        places: tuple[Place, ...] = (),
    ) -> None:
        self._station = station
        self._fogs = {(fog.fleet, fog.number): fog for fog in fogs}
        self._log = log
        self._group = group
        self._changed = changed
        self._names = {(place.latitude_deg, place.longitude_deg): place.name for place in places}
        self._of_id: dict[tuple[str, CommandId], Order] = {}
        self._plans: dict[DroneKey, Plan] = {}
        self._uploads: dict[DroneKey, Order] = {}
        """The newest upload under way to each drone: the plan of an older one is not flown."""
        self._last = 0
        self.orders: deque[Order] = deque(maxlen=KEPT)

    def carry_out(self, request: Request) -> Order:
        """Carry out a request; returns the order that follows it. A command that cannot be sent has that as a word.

        Raises ConfigurationError for a choice that is under way already.
        """
        if isinstance(request, TakeOverRequest):
            order = self._new(f"take control of {_drones(request.drones)}", 0.0, 0.0)
            for key in sorted({key[:2] for key in request.drones}):
                drones = tuple(drone for *of, drone in request.drones if tuple(of) == key)
                self._start(order, self._take_over(order, key, drones))
            return order
        if isinstance(request, UploadRequest):
            name, plan = printable(request.name), request.plan
            text = f"upload {name} ({plan}) to {_drones((request.drone,))}"
            order = self._new(text, request.ttl_s, UploadPlan.limit_s)
            order.path = path_of(plan)
            self._plans.pop(request.drone, None)
            self._uploads[request.drone] = order
            self._start(order, self._upload(order, request))
            return order
        if isinstance(request, MissionRequest):
            return self._fly(request)
        command, target = request.command, request.target
        if target.best:
            self._check_choice(command)
        goal = _goal(command)
        name = f" ({self._names[goal]})" if goal in self._names else ""
        order = self._new(f"{_text(command)}{name} to {_who(target)}", request.ttl_s, command.limit_s)
        order.goal, order.choice = goal, command if target.best else None
        for sender in self._senders(command, target, request.ttl_s):
            self._send(order, sender)
        return order

    def on_event(self, event: Event) -> None:
        """Add an outcome that settles an `unconfirmed`: by then no task follows the command."""
        if isinstance(event, Outcome) and event.settled and (event.fleet, event.id) in self._of_id:
            self._add(self._of_id[event.fleet, event.id], event)

    def _check_choice(self, command: Command) -> None:
        """Refuse the second of a double click: with the first drone busy (R7.4) it would send another one there."""
        before = next((order for order in self.orders if order.choice == command and order.waiting), None)
        if before is not None:
            raise ConfigurationError(f"not sent: the same command has no last word yet: {before.text}")

    def _senders(self, command: Command, target: Target, ttl_s: float) -> list[Callable[[], SentCommand[Any, Any]]]:
        if target.best:
            return [lambda: self._station.best(command, [self._fog(key) for key in target.fogs], ttl_s=ttl_s)]
        if target.fogs:
            return [lambda key=key: self._fog(key).broadcast(command, ttl_s=ttl_s) for key in target.fogs]  # type: ignore[misc]
        return [
            lambda key=key: self._drone(key).send(command, ttl_s=ttl_s)  # type: ignore[misc]
            for key in target.drones
        ]

    def _fog(self, key: FogKey) -> Fog:
        if key not in self._fogs:
            raise FogUnreachable(f"fog {in_fleet(*key)}: the page is not connected to it")
        return self._fogs[key]

    def _drone(self, key: DroneKey) -> Drone:
        fleet, fog, drone = key
        return self._fog((fleet, fog)).drone(drone)

    def _fly(self, request: MissionRequest) -> Order:
        plan = self._plans.get(request.drone)
        what = "resume" if request.resume else "start"
        order = self._new(f"{what} mission of {_drones((request.drone,))}", request.ttl_s, StartMission.limit_s)
        if plan is None:
            self._say(order, "not sent", "upload its plan first: a start names the mission that is to be flown")
            return order
        command = Resume(plan.mission_hash) if request.resume else StartMission(plan.mission_hash)
        (sender,) = self._senders(command, Target(drones=(request.drone,)), request.ttl_s)
        self._send(order, sender)
        return order

    def _new(self, text: str, ttl_s: float, limit_s: float) -> Order:
        if len(self.orders) == KEPT:
            oldest = self.orders[0].number  # a word of an older one may have come since
            self._of_id = {key: order for key, order in self._of_id.items() if order.number > oldest}
        self._last += 1
        order = Order(self._last, text, ttl_s, limit_s, asyncio.get_running_loop().time())
        self.orders.append(order)
        self._log.add("Sent", text)
        self._changed(order)
        return order

    def _send(self, order: Order, sender: Callable[[], SentCommand[Any, Any]]) -> None:
        """Send at once, then follow: every part is sent before any word is awaited."""
        try:
            sent = sender()
        except MqttxtError as error:
            self._say(order, "not sent", printable(str(error)))
            return
        self._start(order, self._follow(order, sent))

    def _start(self, order: Order, following: Coroutine[Any, Any, None]) -> None:
        order.waiting += 1
        self._changed(order)
        self._group.create_task(following)

    @contextlib.contextmanager
    def _waiting(self, order: Order, otherwise: str, who: str = "") -> Iterator[None]:
        """One part of an order up to its end; an error is said with the word `otherwise`."""
        try:
            yield
        except MqttxtError as error:
            self._say(order, otherwise, f"{who}{printable(str(error))}")
        finally:
            order.waiting -= 1
            self._changed(order)

    async def _follow(self, order: Order, sent: SentCommand[Any, Any]) -> None:
        with self._waiting(order, "not known"):
            async for said in sent:
                if isinstance(said, PsmiList):
                    text, plain = choice_in_plain_english(said)
                    self._enter(order, "choice", text, plain, code_of(said))
                else:
                    self._of_id[said.fleet, said.id] = order
                    self._add(order, said)

    async def _take_over(self, order: Order, key: FogKey, drones: tuple[int, ...]) -> None:
        """Take a fog's drones at once: a takeover raises its epoch, and one with an older epoch takes none (R6.7)."""
        names = [in_fleet(key[0], drone) for drone in drones]
        with self._waiting(order, "failed", f"drone {', '.join(names)}: "):
            await self._fog(key).take_over(drones=drones)
            for name in names:
                self._say(order, "completed", f"drone {name}: This station controls it.")

    async def _upload(self, order: Order, request: UploadRequest) -> None:
        key, plan = request.drone, request.plan

        def tell(done: int, size: int) -> None:
            order.progress = f"{done} of {size} bytes are at the drone"
            if done == size:
                order.progress += "; it writes the plan into its autopilot, and reads it back"
            self._changed(order)

        with self._waiting(order, "failed"):
            outcome = await self._drone(key).upload(plan, timeout_s=CARRIED_S, ttl_s=request.ttl_s, progress=tell)
            if outcome.completed and self._uploads.get(key) is order:
                self._plans[key] = plan
            self._of_id[outcome.fleet, outcome.id] = order
            self._add(order, outcome)
        if self._uploads.get(key) is order:
            del self._uploads[key]

    def _add(self, order: Order, outcome: Outcome) -> None:
        self._enter(order, outcome.word.label, headline(outcome), in_plain_english(outcome), code_of(outcome))

    def _say(self, order: Order, word: str, text: str) -> None:
        """Add a text to an order that is no drone's word."""
        self._log.add("Answer", f"{order.text}: {word}: {text}")
        self._enter(order, word, f"{word}: {text}")

    def _enter(self, order: Order, word: str, text: str, plain: str = "", code: str | None = None) -> None:
        order.words.append({"word": word, "text": text, "plain": plain, "code": code})
        self._changed(order)


def _text(command: Command) -> str:
    """A command with its parameters, such as `takeoff altitude 10 m`."""
    parts = [
        f"{field.name.rpartition('_')[0]} {getattr(command, field.name):g}{_UNITS[field.name]}"
        if field.name == "altitude_m"
        else f"{field.name.rpartition('_')[0]} {getattr(command, field.name):.7f}{_UNITS[field.name]}"
        for field in layout_of(type(command)).fields
    ]
    return " ".join([command.name, *parts])


def _who(target: Target) -> str:
    if target.drones:
        return _drones(target.drones)
    fogs = f"fog {', '.join(in_fleet(*key) for key in target.fogs)}"
    return f"whoever arrives first of {fogs}" if target.best else f"all drones of {fogs}"


def _drones(drones: tuple[DroneKey, ...]) -> str:
    return f"drone {', '.join(in_fleet(fleet, drone) for fleet, _, drone in drones)}"


def _goal(command: Command) -> tuple[float, float] | None:
    return (command.latitude_deg, command.longitude_deg) if isinstance(command, Goto) else None
