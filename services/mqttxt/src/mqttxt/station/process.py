"""The ground station as a process: its connection, its role, and the tasks that wait for its events."""

from __future__ import annotations

import asyncio
import logging
import ssl
import threading
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar, get_args
from weakref import WeakSet

from ..core.address import BrokerAddress
from ..core.clock import SessionClock
from ..core.effects import Inbound
from ..core.ledger import OVERRIDING
from ..core.mqtt.link import MqttLink
from ..core.mqtt.properties import MOST_ALIASES
from ..core.runner import Runner
from ..errors import ConfigurationError, FogUnreachable, StationEnded, TransferFailed
from ..protocol.commands import Command
from ..protocol.messages import CommandId
from ..protocol.rankings import SelectMode
from .choices import Choices
from .commands import Output, ttl_ms_of
from .fog import LINK, FogView
from .heard import Bell, Events, EventStream, Record, SentCommand
from .outcomes import Event, ListBehind, Outcome, PsmiList, last_word
from .role import StationRole
from .transfers import Transfer

if TYPE_CHECKING:
    from ..security.identity import Identity

logger = logging.getLogger("mqttxt")

LONGEST_STILL_MS = 163_840
"""How long a station may have stood still: a quarter of the stamps' span, up to which they give order and age."""
_OLD = "this process stood still, and what it has received is old"

Answer = TypeVar("Answer")
AnEvent = TypeVar("AnEvent", bound=Event)


class StationRunner(Runner):
    """Runs one ground station's role, and passes its events to followed commands, streams and waiting conditions."""

    def __init__(
        self,
        station: StationRole,
        address: BrokerAddress,
        clock: SessionClock,
        ssl_context: ssl.SSLContext | None,
        identity: Identity | None = None,
    ) -> None:
        super().__init__(station, clock, identity=identity, lists={LINK: station.lists_topic})
        self.station = station
        self.fleet = ""
        """The fleet's name, which every event carries, where this is one station of several fleets."""
        client_id = f"mqttxt-{station.name}-{clock.session:08x}"
        self.links[LINK] = MqttLink(
            LINK,
            address,
            client_id,
            station.will,
            events=self,
            ssl_context=ssl_context,
            identity=identity,
            may_be_ended=not station.signs,
            aliases=MOST_ALIASES,
        )
        self._open: dict[CommandId, Record[Any]] = {}
        self._streams: WeakSet[Events] = WeakSet()
        self.choices = Choices()
        self._carried_out = Bell()
        self._running: asyncio.Task[None] | None = None
        self._thread = 0
        """The thread that runs the station's event loop."""
        self.does |= dict.fromkeys(get_args(Event), self._hear)

    @property
    def has_begun(self) -> bool:
        return self._running is not None

    def begin(self) -> None:
        """Run until `stop`. Raises StationEnded if it has run before, ConfigurationError for an unfit event loop."""
        if self._running is not None:
            raise StationEnded("a ground station is entered once: make another GroundStation")
        loop = type(asyncio.get_running_loop())
        if loop.add_reader is asyncio.AbstractEventLoop.add_reader:
            wanted = "asyncio.Runner(loop_factory=asyncio.SelectorEventLoop)"
            raise ConfigurationError(f"event loop {loop.__name__}: does not watch sockets; expected that of {wanted}")
        self._thread = threading.get_ident()
        self._running = asyncio.create_task(self.run())
        self._running.add_done_callback(lambda _: self._on_end())

    def stop(self) -> asyncio.Task[None]:
        """Stop the role cleanly; returns the task that ends then."""
        assert self._running is not None
        self._running.cancel()
        return self._running

    def result(self) -> None:
        """Raises the error that ended the station; nothing where it was left."""
        assert self._running is not None
        if not self._running.cancelled():
            self._running.result()

    def check(self) -> None:
        """Raises the error that ended the station, StationEnded where it was left; nothing while it runs.

        Raises ConfigurationError in another thread or event loop than the station's.
        """
        if (error := self._ended_by()) is not None:
            raise error.with_traceback(None)  # which would grow with each call
        self._check_loop()

    def _check_loop(self) -> None:
        """Raises ConfigurationError in another thread or event loop: who waits there would not be woken."""
        if self._running is None or self._running.done():
            return
        own = self._running.get_loop()
        try:
            running = asyncio.get_running_loop()
        except RuntimeError:
            running = own
        if running is not own or threading.get_ident() != self._thread:
            raise ConfigurationError("GroundStation: another thread or event loop; expected the one that entered it")

    def _ended_by(self) -> BaseException | None:
        """The error that ended the station, from the moment on at which it sends nothing more; None before."""
        error = self.stopped_by()
        was_left = isinstance(error, asyncio.CancelledError) or (error is None and self._has_ended)
        return StationEnded("the ground station has ended") if was_left else error

    @property
    def _has_ended(self) -> bool:
        return self._running is not None and self._running.done()

    def received(self, link: str, message: Inbound) -> None:
        """Take a message, unless this process stood still for so long that the socket may hold very old ones."""
        if self._stood_too_long():  # this is called before the tick that is overdue
            self.links[link].give_up(_OLD)
        else:
            super().received(link, message)

    def stood_still(self) -> None:
        """Connect anew after a long time: what was sent in it may also arrive later."""
        if self._stood_too_long() and self.station.connected:
            self.links[LINK].give_up(_OLD)

    def _stood_too_long(self) -> bool:
        return self.clock.now_ms() - self.ticked_ms > LONGEST_STILL_MS

    def send(
        self,
        fog: FogView,
        drone: int | None,
        command: Command,
        ttl_s: float,
        limit_s: float | None,
        answer: Callable[[Sequence[Outcome]], Answer],
    ) -> SentCommand[Answer, Outcome]:
        """Send a command now and follow it. Raises what `StationCommands.send` and `check` raise, with nothing sent."""
        ttl_ms = ttl_ms_of(ttl_s)
        self.check()
        self.check_certificate(command)
        commands, now_ms = self.station.commands, self.clock.now_ms()
        return self._follow(commands.send(fog, drone, command, now_ms, ttl_ms=ttl_ms, limit_s=limit_s), answer)

    def select(
        self,
        fog: int,
        command: Command,
        mode: SelectMode,
        ttl_s: float,
        limit_s: float | None = None,
        reservation: int | None = None,
        drone: int | None = None,
    ) -> SentCommand[Outcome, Outcome | PsmiList]:
        """Send a command, or a step of a choice, to a fog whose activator chooses the drone; errors as `send`."""
        ttl_ms = ttl_ms_of(ttl_s)
        self.check()
        self.check_certificate(command)
        view, now_ms = self.station.fog(fog, command.name), self.clock.now_ms()
        sent = self.station.commands.select(
            view, command, now_ms, mode=mode, reservation=reservation, ttl_ms=ttl_ms, limit_s=limit_s, drone=drone
        )
        return self._follow(sent, last_word)

    def check_certificate(self, command: Command) -> None:
        """Raises ConfigurationError for a wrong certificate, but not for commands that bring drones down (R11.11)."""
        wrong = self.identity.wrong if self.identity is not None else None
        if wrong is not None and not isinstance(command, OVERRIDING):
            raise ConfigurationError(
                f"{command.name}: this station's certificate is {wrong}; expected hold, land or return"
            )

    def _follow(
        self, sent: tuple[CommandId, list[Output]], answer: Callable[[Sequence[Any]], Answer]
    ) -> SentCommand[Answer, Any]:
        command_id, outputs = sent
        record = self._open[command_id] = Record[Any]()
        self.carry_out(outputs)
        return SentCommand(record, answer)

    def listen(self, record: Events | None = None) -> EventStream:
        """Every event from now on, in a record that may receive other stations' events too."""
        record = Events() if record is None else record
        self._streams.add(record)
        if self._has_ended:
            self._end_all()
        return EventStream(record)

    def of_fleet(self, event: AnEvent) -> AnEvent:
        """An event with the fleet's name, where there are several fleets."""
        return replace(event, fleet=self.fleet) if self.fleet else event

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """`GroundStation.wait_until`."""
        check_timeout(timeout_s)
        self._check_loop()
        async with asyncio.timeout(timeout_s if timeout_s < float("inf") else None):
            while not condition():
                if self._has_ended:
                    self.check()
                await self._carried_out.wait()

    async def transfer(
        self, transfer: Transfer, timeout_s: float | None, on_news: Callable[[], Awaitable[None]] | None = None
    ) -> None:
        """Transfer an object, and wait until it has arrived; raises TransferFailed where it fails or takes too long.

        `on_news` is awaited whenever the transfer has news; an exception in it ends the transfer.
        """
        if timeout_s is not None:
            check_timeout(timeout_s)
        self.check()
        self.carry_out(self.station.transfers.begin(transfer, self.clock.now_ms()))
        try:
            async with asyncio.timeout(timeout_s) as limit:
                while not transfer.is_over:
                    await self.wait_until(
                        lambda: transfer.is_over if on_news is None else transfer.has_news, float("inf")
                    )
                    if on_news is not None:
                        await on_news()
        except TimeoutError:
            if not limit.expired():  # it is the caller's own
                raise
            raise TransferFailed(f"{transfer}: not within {timeout_s:g} s") from None
        finally:
            transfer.is_over = True
        if transfer.error is not None:
            raise TransferFailed(f"{transfer}: {transfer.error}", transfer.error)

    async def take_over(self, fog: int, drones: tuple[int, ...] | None, timeout_s: float) -> None:
        """`GroundStation.take_over`."""
        check_timeout(timeout_s)
        self.check()
        self.carry_out(self.station.take_over(fog, drones, self.clock.now_ms()))
        view = self.station.fogs[fog]
        wanted = drones if drones is not None else view.present
        try:
            await self.wait_until(lambda: all(view.controls(drone) for drone in wanted), timeout_s)
        except TimeoutError:
            raise FogUnreachable(f"fog {fog}: the takeover was not confirmed within {timeout_s:g} s") from None

    def claim(self, fog: int, drone: int, wanted: bool) -> None:
        """`Drone.claim` and `Drone.release`."""
        self.check()
        self.carry_out(self.station.claim(fog, drone, wanted, self.clock.now_ms()))

    def carried_out(self) -> None:
        pending = self.station.commands.pending
        for command_id in [command_id for command_id in self._open if not pending[command_id].is_open]:
            self._open.pop(command_id).end()
        self._carried_out.ring()

    def _hear(self, said: Event) -> None:
        event = self.of_fleet(said)
        if isinstance(event, ListBehind):
            logger.warning("%s", event)
        for stream in list(self._streams):
            stream.hear(event)
        if isinstance(event, Outcome | PsmiList) and event.id in self._open:
            self._open[event.id].hear(event)

    def _on_end(self) -> None:
        error = self._ended_by()
        if self.fleet and not isinstance(error, StationEnded):
            logger.error("fleet %s: %s", self.fleet, error)
        self._end_all()

    def _end_all(self) -> None:
        """End every followed command and every stream, so that no task waits for a station that has ended."""
        error = self._ended_by()
        while self._open:
            self._open.popitem()[1].end(error)
        for stream in list(self._streams):
            stream.end(None if isinstance(error, StationEnded) else error)
        self._streams.clear()
        self._carried_out.ring()


async def leave(*runners: StationRunner) -> None:
    """End the choices of stations and stop their roles cleanly; whoever cancels this ends only the wait for that."""
    try:
        for runner in runners:
            await runner.choices.end()  # they release their reservations, in other fleets too
    finally:
        await asyncio.wait([runner.stop() for runner in runners])


def check_timeout(timeout_s: float) -> None:
    """Raises ConfigurationError unless it is above 0."""
    if not timeout_s > 0:
        raise ConfigurationError(f"timeout {timeout_s:g} s: expected more than 0")
