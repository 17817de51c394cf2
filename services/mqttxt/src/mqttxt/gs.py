"""The ground station's public API, on asyncio.

async with GroundStation("mqtt://cloud.example:1883") as gs:
    fog, other = await gs.connect([1, 2])
    async for outcome in fog.broadcast(Takeoff(altitude_m=10)):
        print(outcome)
    last_word = await fog.drone(3).send(Goto(47.3980, 8.5460, altitude_m=15))
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Callable, Hashable, Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from .clock import DEFAULT_TTL_MS, SessionClock
from .commands import Command
from .errors import FogUnreachable
from .io.mqtt import BrokerAddress, MqttLink
from .io.runner import Runner
from .messages import CommandId
from .outcomes import Event, Outcome, Reachability, StateUpdate
from .roles.effects import Inbound
from .roles.ground_station import GroundStation as Station
from .roles.settings import Settings
from .roles.station_fog import LINK, FogView
from .states import State
from .topics import check_number, check_station_name
from .wire.values import Encoding


@dataclass(frozen=True)
class KnownState:
    """A state as last heard; `age_ms` is an upper bound of its age now, None where the fog has no clock of it."""

    state: State
    age_ms: int | None


class _StationRole:
    """The ground station's role as the runner takes it: one link, one loop."""

    def __init__(self, station: Station) -> None:
        self._station = station
        self.on_subscribed = station.on_subscribed
        self.tick = station.tick
        self.goodbye = station.goodbye

    def on_connected(self, link: str, now_ms: int) -> Any:
        return self._station.on_connected(now_ms)

    def on_disconnected(self, link: str, now_ms: int) -> Any:
        return self._station.on_disconnected(now_ms)

    def on_message(self, link: str, message: Inbound, now_ms: int) -> Any:
        return self._station.on_message(message, now_ms)

    def on_published(self, link: str, ref: Hashable, code: int, now_ms: int) -> Any:
        return ()

    def is_ready(self, now_ms: int) -> bool:
        return self._station.connected


class GroundStation(Runner):
    """A ground station at a cloud broker; an async context manager.

    `url` is `mqtt://[user:password@]host[:port]` or `mqtts://…`; `name` is random unless given; `qos` 0 or 1
    is that of commands. Raises ConfigurationError for a setting that cannot work.
    """

    def __init__(
        self,
        url: str,
        *,
        name: str | None = None,
        qos: int = 1,
        encoding: Encoding = Encoding.CBOR,
        prefix: str = "",
        clock: SessionClock | None = None,
    ) -> None:
        own_clock = clock or SessionClock()
        self.name = check_station_name(name) if name is not None else f"gs-{secrets.token_hex(4)}"
        settings = Settings(qos=qos, encoding=encoding)
        self.station = Station(self.name, own_clock.session, settings, prefix=prefix)
        super().__init__(_StationRole(self.station), own_clock)
        client_id = f"mqttxt-{self.name}-{own_clock.session:08x}"
        self.links[LINK] = MqttLink(LINK, BrokerAddress.parse(url), client_id, self.station.will(), self)
        self._listeners: list[Callable[[Event], None]] = []
        self._changed = asyncio.Event()
        self._running: asyncio.Task[None] | None = None

    @property
    def session(self) -> int:
        return self.clock.session

    async def __aenter__(self) -> Self:
        self._running = asyncio.create_task(self.run())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._running is not None
        self._running.cancel()
        await asyncio.wait([self._running])
        if error is None and not self._running.cancelled():
            self._raise_if_ended()

    async def connect(self, fogs: Iterable[int], timeout_s: float = 10.0) -> list[Fog]:
        """Register at fogs and wait until each has confirmed; raises FogUnreachable after `timeout_s`."""
        numbers = [check_number("fog", number) for number in fogs]
        self.carry_out(self.station.add_fogs(numbers))
        views = [self.station.fogs[number] for number in numbers]
        try:
            await self.wait_until(lambda: all(view.registered for view in views), timeout_s)
        except TimeoutError:
            silent = ", ".join(str(view.number) for view in views if not view.registered)
            where = "" if self.station.connected else f"; {self.links[LINK].address} is not connected"
            raise FogUnreachable(f"fog {silent}: no activator answered within {timeout_s:g} s{where}") from None
        return [Fog(self, view) for view in views]

    def fog(self, number: int) -> Fog:
        """A fog that `connect` was called with; raises FogUnreachable for another."""
        if number not in self.station.fogs:
            raise FogUnreachable(f"fog {number}: connect to it first")
        return Fog(self, self.station.fogs[number])

    async def events(self) -> AsyncIterator[Event]:
        """Everything that is heard from now on: outcomes, states, reachability."""
        queue: asyncio.Queue[Event] = asyncio.Queue()
        self._listeners.append(queue.put_nowait)
        try:
            while True:
                yield await self._next(queue)
        finally:
            self._listeners.remove(queue.put_nowait)

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait until `condition` holds; it is looked at whenever something was heard. Raises TimeoutError."""
        async with asyncio.timeout(timeout_s):
            while not condition():
                self._raise_if_ended()
                self._changed.clear()
                waiter = asyncio.ensure_future(self._changed.wait())
                try:
                    await asyncio.wait({waiter, *self._ending()}, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    waiter.cancel()

    def carry_out(self, outputs: Iterable[Any]) -> None:
        super().carry_out(outputs)
        self._changed.set()

    def special(self, output: Any) -> None:
        if isinstance(output, Outcome | StateUpdate | Reachability):
            for listener in list(self._listeners):
                listener(output)
        else:
            super().special(output)

    async def send(
        self, fog: int, drone: int | None, command: Command, ttl_s: float, limit_s: float | None
    ) -> AsyncIterator[Outcome]:
        """Send a command and yield its outcomes, up to the last word of each drone."""
        queue: asyncio.Queue[Event] = asyncio.Queue()
        self._listeners.append(queue.put_nowait)
        try:
            command_id, effects = self.station.send(
                fog, drone, command, self.clock.now_ms(), ttl_ms=round(ttl_s * 1000), limit_s=limit_s
            )
            self.carry_out(effects)
            pending = self.station.commands[command_id]
            while pending.is_open or not queue.empty():
                event = await self._next_unless_closed(queue, command_id)
                if event is None:
                    return
                if isinstance(event, Outcome) and event.id == command_id:
                    yield event
        finally:
            self._listeners.remove(queue.put_nowait)

    async def _next_unless_closed(self, queue: asyncio.Queue[Event], command_id: CommandId) -> Event | None:
        """The next event; None once the command is closed without one (an empty roster)."""
        pending = self.station.commands[command_id]
        while queue.empty():
            if not pending.is_open:
                return None
            await self.wait_until(lambda: not queue.empty() or not pending.is_open, timeout_s=3600)
        return queue.get_nowait()

    async def _next(self, queue: asyncio.Queue[Event]) -> Event:
        while queue.empty():
            self._raise_if_ended()
            waiter = asyncio.ensure_future(queue.get())
            await asyncio.wait({waiter, *self._ending()}, return_when=asyncio.FIRST_COMPLETED)
            if waiter.done():
                return waiter.result()
            waiter.cancel()
        return queue.get_nowait()

    def _ending(self) -> set[asyncio.Task[None]]:
        return {self._running} if self._running is not None else set()

    def _raise_if_ended(self) -> None:
        """Raise what ended the station, so that nobody waits for it in vain."""
        if self._running is not None and self._running.done() and not self._running.cancelled():
            error = self._running.exception()
            while isinstance(error, BaseExceptionGroup):
                error = error.exceptions[0]
            if error is not None:
                raise error


class Fog:
    """One fog, as its ground station sees it."""

    def __init__(self, station: GroundStation, view: FogView) -> None:
        self._station = station
        self._view = view

    @property
    def number(self) -> int:
        return self._view.number

    @property
    def is_live(self) -> bool:
        """Whether its activator is there: it says so, and its beacons keep coming."""
        return self._view.is_live(self._station.clock.now_ms())

    @property
    def drones(self) -> list[Drone]:
        """Every drone that the fog knows, by number."""
        numbers = {*self._view.drones, *self._view.configured}
        return [Drone(self._station, self._view, number) for number in sorted(numbers)]

    def drone(self, number: int) -> Drone:
        return Drone(self._station, self._view, number)

    def broadcast(
        self, command: Command, *, ttl_s: float = DEFAULT_TTL_MS / 1000, limit_s: float | None = None
    ) -> AsyncIterator[Outcome]:
        """Send a command to every drone of the fog; yields each one's words up to its last.

        `ttl_s` bounds the start of the execution (at most 60), `limit_s` its end. Raises FogUnreachable when
        the activator is not live: the command was not sent then.
        """
        return self._station.send(self.number, None, command, ttl_s, limit_s)


class Drone:
    """One drone, as its ground station sees it."""

    def __init__(self, station: GroundStation, view: FogView, number: int) -> None:
        self._station = station
        self._view = view
        self.number = number

    @property
    def is_reachable(self) -> bool:
        drone = self._view.drones.get(self.number)
        return drone is not None and drone.reachable

    @property
    def states(self) -> dict[str, KnownState]:
        """The newest state of each name."""
        drone = self._view.drones.get(self.number)
        now_ms = self._station.clock.now_ms()
        return {
            name: KnownState(known.message.state, self._view.age_ms(known, now_ms))
            for name, known in (drone.states if drone is not None else {}).items()
        }

    def outcomes(
        self, command: Command, *, ttl_s: float = DEFAULT_TTL_MS / 1000, limit_s: float | None = None
    ) -> AsyncIterator[Outcome]:
        """Send a command and yield its words up to the last one; errors as `Fog.broadcast`."""
        return self._station.send(self._view.number, self.number, command, ttl_s, limit_s)

    async def send(
        self, command: Command, *, ttl_s: float = DEFAULT_TTL_MS / 1000, limit_s: float | None = None
    ) -> Outcome:
        """Send a command and wait for its last word."""
        last = None
        async for outcome in self.outcomes(command, ttl_s=ttl_s, limit_s=limit_s):
            last = outcome
        assert last is not None
        return last


__all__ = ["Drone", "Fog", "GroundStation", "KnownState"]
