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
from types import TracebackType
from typing import Any, Self

from ..core.clock import DEFAULT_TTL_MS, SessionClock
from ..core.effects import Inbound
from ..core.mqtt.link import BrokerAddress, MqttLink
from ..core.runner import Runner
from ..core.settings import Settings
from ..errors import ConfigurationError, FogUnreachable, StationEnded
from ..protocol.commands import Command
from ..protocol.messages import CommandId
from ..protocol.topics import check_number, check_station_name
from ..protocol.values import Encoding
from .best import best
from .commands import ttl_ms_of
from .fog import LINK
from .outcomes import Event, Outcome, PsmiList
from .role import GroundStation as Station
from .views import Drone, Fog, KnownState


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
    is that of commands. With `control` it takes control of every drone that is free, without it only watches;
    `bundles` asks for states together, at most once a second. Raises ConfigurationError for a setting that cannot
    work.
    """

    def __init__(
        self,
        url: str,
        *,
        name: str | None = None,
        qos: int = 1,
        encoding: Encoding = Encoding.CBOR,
        prefix: str = "",
        control: bool = True,
        bundles: bool = False,
        clock: SessionClock | None = None,
    ) -> None:
        own_clock = clock or SessionClock()
        self.name = check_station_name(name) if name is not None else f"gs-{secrets.token_hex(4)}"
        settings = Settings(qos=qos, encoding=encoding, bundles=bundles)
        self.station = Station(self.name, own_clock.session, settings, prefix=prefix, control=control)
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
            self._running.result()

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
        """Everything that is heard from now on: outcomes, states, reachability; ends with the station."""
        queue: asyncio.Queue[Event] = asyncio.Queue()
        self._listeners.append(queue.put_nowait)
        try:
            while (event := await self._next(queue)) is not None:
                yield event
        finally:
            self._listeners.remove(queue.put_nowait)

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait until `condition` holds; it is looked at whenever something was heard.

        Raises TimeoutError, and StationEnded where the station ends before.
        """
        if not timeout_s > 0:
            raise ConfigurationError(f"timeout {timeout_s:g} s: expected more than 0")
        async with asyncio.timeout(timeout_s):
            while not condition():
                if self._has_ended():
                    raise StationEnded("the ground station has ended")
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
        if isinstance(output, Event):
            for listener in list(self._listeners):
                listener(output)
        else:
            super().special(output)

    async def send(
        self, fog: int, drone: int | None, command: Command, ttl_s: float, limit_s: float | None
    ) -> AsyncIterator[Outcome]:
        """Send a command and yield its outcomes, up to the last word of each drone."""
        ttl_ms = ttl_ms_of(ttl_s)

        def start() -> tuple[CommandId, list[Any]]:
            return self.station.send(fog, drone, command, self.clock.now_ms(), ttl_ms=ttl_ms, limit_s=limit_s)

        async for event in self.follow(start):
            if isinstance(event, Outcome):
                yield event

    async def best(
        self,
        command: Command,
        fogs: Iterable[int] | None = None,
        *,
        ttl_s: float = DEFAULT_TTL_MS / 1000,
        limit_s: float | None = None,
    ) -> AsyncIterator[Outcome | PsmiList]:
        """Send a command to the drone that arrives first; yields PSMI's lists and the words of whoever it went to.

        One fog chooses by itself and tries the next drone after a definite no. Of several (by default all that
        are connected) each reserves its best, and the best of those gets the command; after a definite no the next.
        Raises FogUnreachable when none of the activators is live.
        """
        numbers = [*self.station.fogs] if fogs is None else [*fogs]
        async for event in best(self, command, numbers, ttl_s, limit_s):
            yield event

    async def take_over(self, fog: int, drones: tuple[int, ...] | None = None, timeout_s: float = 10.0) -> None:
        """Take control of a fog's drones, whoever has it; raises FogUnreachable when that is not confirmed."""
        view = self.station.fogs[fog]
        self.carry_out(self.station.take_over(fog, drones, self.clock.now_ms()))
        wanted = drones if drones is not None else tuple({*view.drones, *view.configured})
        try:
            await self.wait_until(lambda: all(view.controls(drone) for drone in wanted), timeout_s)
        except TimeoutError:
            raise FogUnreachable(f"fog {fog}: the takeover was not confirmed within {timeout_s:g} s") from None

    async def follow(self, start: Callable[[], tuple[CommandId, list[Any]]]) -> AsyncIterator[Outcome | PsmiList]:
        """Start a command and yield what is said of it until it is closed."""
        queue: asyncio.Queue[Event] = asyncio.Queue()
        self._listeners.append(queue.put_nowait)
        try:
            command_id, effects = start()
            self.carry_out(effects)
            pending = self.station.commands.pending[command_id]
            while pending.is_open or not queue.empty():
                event = await self._next_unless_closed(queue, command_id)
                if event is None:
                    return
                if isinstance(event, Outcome | PsmiList) and event.id == command_id:
                    yield event
        finally:
            self._listeners.remove(queue.put_nowait)

    async def _next_unless_closed(self, queue: asyncio.Queue[Event], command_id: CommandId) -> Event | None:
        """The next event; None once the command is closed without one (an empty roster)."""
        pending = self.station.commands.pending[command_id]
        while queue.empty():
            if not pending.is_open:
                return None
            await self.wait_until(lambda: not queue.empty() or not pending.is_open, timeout_s=3600)
        return queue.get_nowait()

    async def _next(self, queue: asyncio.Queue[Event]) -> Event | None:
        """The next event; None once the station has ended and all it heard was told."""
        while queue.empty():
            if self._has_ended():
                return None
            waiter = asyncio.ensure_future(queue.get())
            try:
                await asyncio.wait({waiter, *self._ending()}, return_when=asyncio.FIRST_COMPLETED)
                if waiter.done():
                    return waiter.result()
            finally:
                waiter.cancel()
        return queue.get_nowait()

    def _ending(self) -> set[asyncio.Task[None]]:
        return {self._running} if self._running is not None else set()

    def _has_ended(self) -> bool:
        """Whether nothing more will be heard; raises what ended the station, so that nobody waits for it in vain."""
        if self._running is None or not self._running.done():
            return False
        if not self._running.cancelled():
            self._running.result()
        return True


__all__ = ["Drone", "Fog", "GroundStation", "KnownState"]
