"""Runs a role: carries its effects out in their order, passes it the messages that arrive, ticks it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import Counter
from collections.abc import Callable, Coroutine, Hashable, Iterable, Mapping
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from ..errors import ConfigurationError, Refused
from .bond import Bond
from .clock import SessionClock
from .effects import Audit, Inbound, Log, Publish, Reconnect, Stop, Subscribe, Unsubscribe
from .hearing import STALL_MS
from .mqtt.link import MqttLink
from .ready_file import ReadyFile
from .settings import REBIRTH_MS
from .shared_lists import LISTS, SharedLists

if TYPE_CHECKING:
    from ..security.identity import Identity
    from ..security.revocation import RevocationList
    from .audit_log import AuditLog
    from .service import Service

logger = logging.getLogger("mqttxt")

TICK_S = 0.05
READY_TOUCH_S = 1.0
KEEP_AGAIN_S = 10.0
"""Pause after a revocation list could not be written to disk; the list is in force nevertheless."""


class Role(Protocol):
    """The interface of every role's state machine. `link` names the connection, for roles that have several."""

    def on_connected(self, link: str, now_ms: int) -> Iterable[Any]: ...
    def on_disconnected(self, link: str, now_ms: int) -> Iterable[Any]: ...
    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> Iterable[Any]: ...
    def on_message(self, link: str, message: Inbound, now_ms: int) -> Iterable[Any]: ...
    def on_published(self, link: str, ref: Hashable, code: int, now_ms: int) -> Iterable[Any]: ...
    def on_identity(self, now_ms: int) -> Iterable[Any]:
        """The identity has a new key, or its fleet a newer revocation list."""
        ...

    def tick(self, now_ms: int) -> Iterable[Any]: ...
    def goodbye(self, now_ms: int) -> Iterable[Any]: ...
    def is_ready(self, now_ms: int) -> bool: ...


class Runner:
    """Runs one role with its clock, identity and links. `does` has the function for each kind of effect but Publish.

    Subclasses add the effects and events that only their role has.

    `lists` has the topics of the revocation list, by connection. `patience_ms` is how long other nodes have to publish
    it first, None if this node never does. `told` has the topics of connections on which only this node publishes it.
    Raises ConfigurationError if the folder of the ready file does not exist.
    """

    def __init__(
        self,
        role: Role,
        clock: SessionClock,
        ready_file: Path | None = None,
        identity: Identity | None = None,
        lists: Mapping[str, str] | None = None,
        patience_ms: int | None = REBIRTH_MS,
        audit: AuditLog | None = None,
        told: Mapping[str, str] | None = None,
    ) -> None:
        self._ready_file = ReadyFile(ready_file, self.count) if ready_file is not None else None
        self.role = role
        self.clock = clock
        self.identity = identity
        self._audit = audit
        self.service: Service | None = None
        self.links: dict[str, MqttLink] = {}
        self.bonds: dict[str, Bond] = {}
        """Links of the role that have several connections, which are in `links`."""
        fleet = identity.fleet if identity is not None else None
        self.lists = SharedLists(fleet, lists or {}, patience_ms, told)
        self.counts: Counter[str] = Counter()
        self.ticked_ms = clock.now_ms()
        """When the last tick began."""
        self._told_ms = -10_000
        self._stopped: asyncio.Future[None] | None = None
        self._is_to_keep = asyncio.Event()
        self.does: dict[type[Any], Callable[[Any], object]] = {
            Subscribe: lambda effect: self._way(effect.link).subscribe(effect),
            Unsubscribe: lambda effect: self._way(effect.link).unsubscribe(effect),
            Reconnect: lambda effect: self._way(effect.link).give_up(effect.reason),
            Log: lambda log: self.count(log.kind, log.detail),
            Audit: audit.record if audit is not None else lambda _: None,
            Stop: lambda stop: self._fail(Refused(stop.reason)),
        }

    async def run(self) -> None:
        """Run until cancelled or stopped; after the goodbye raises Refused, or the error of a job that failed."""
        self._stopped = asyncio.get_running_loop().create_future()
        if self._audit is not None:
            self._audit.start(self.clock.session)
        tasks = [asyncio.create_task(job) for job in (*self.jobs(), *self._identity_jobs())]
        for task in tasks:
            task.add_done_callback(self._job_ended)
        try:
            await self._stopped
        finally:
            try:
                await self._say_goodbye()
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.wait(tasks)
                if self._audit is not None:
                    await asyncio.to_thread(self._audit.close)

    def finish(self) -> None:
        """End `run`, with the goodbye but without an error, because the role has done its work."""
        if self._stopped is not None and not self._stopped.done():
            self._stopped.set_result(None)

    def stopped_by(self) -> BaseException | None:
        """The error that ended `run`, CancelledError after a cancellation; None before that and after `finish`."""
        if self._stopped is None or not self._stopped.done():
            return None
        return asyncio.CancelledError() if self._stopped.cancelled() else self._stopped.exception()

    def jobs(self) -> list[Coroutine[Any, Any, None]]:
        """The coroutines that run as long as the role does."""
        bonds = [bond.run() for bond in self.bonds.values()]
        return [*(link.run() for link in self.links.values()), *bonds, self._tick()]

    async def reload(self) -> None:
        """Read revocation list, key and certificate anew; a bad file is logged and changes nothing."""
        identity = self.identity
        if identity is None:
            return
        try:
            found = await asyncio.to_thread(identity.fleet.in_folder)
            if identity.fleet.take(found):
                self._on_newer_list()
            else:
                logger.info("revocation list %d is unchanged", identity.fleet.revoked.number)
            if identity.renew(*await asyncio.to_thread(identity.in_folder)):
                logger.info("%s signs with its new key", identity.name)
                self.carry_out(self.role.on_identity(self.clock.now_ms()))
        except ConfigurationError as error:
            logger.error("%s", error)
        self._is_to_keep.set()

    def tell_own_broker(self, newest: RevocationList) -> None:
        """Pass the revocation list to the broker that this node runs, if any; blocks. Raises ConfigurationError."""

    def _on_newer_list(self) -> None:
        """Apply a newer list, to connections that are already up too."""
        assert self.identity is not None
        logger.info("revocation list %d is in force", self.identity.fleet.revoked.number)
        now_ms = self.clock.now_ms()
        self.lists.on_newer(now_ms)
        for link in self.links.values():
            link.check_broker()
        self.carry_out(self.role.on_identity(now_ms))
        self._is_to_keep.set()

    def _identity_jobs(self) -> list[Coroutine[Any, Any, None]]:
        return [] if self.identity is None else [self._keep_identity(self.identity)]

    async def _keep_identity(self, identity: Identity) -> None:
        """Save the trusted time and the revocation list, at intervals and when a newer list arrives.

        Also log once that the certificate is no longer good.
        """
        from ..security.trusted_time import PERSIST_EVERY_S

        was_good, is_to_tell = True, True
        while True:
            is_to_tell = is_to_tell or self._is_to_keep.is_set()
            self._is_to_keep.clear()
            pause_s = PERSIST_EVERY_S
            try:
                await asyncio.to_thread(identity.time.keep)
            except ConfigurationError as error:
                self.count("time", str(error))
            try:
                if is_to_tell:
                    await asyncio.to_thread(self.tell_own_broker, identity.fleet.revoked)
                    is_to_tell = False
                await asyncio.to_thread(identity.fleet.keep)
            except ConfigurationError as error:
                self.count("revocation_list", str(error))
                pause_s = KEEP_AGAIN_S
            wrong = identity.wrong
            if wrong is not None and was_good:
                logger.error("the certificate of %s is %s", identity.name, wrong)
            was_good = wrong is None
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(pause_s):
                    await self._is_to_keep.wait()

    def carry_out(self, outputs: Iterable[Any]) -> None:
        """Carry out effects in their order."""
        for output in outputs:
            if isinstance(output, Publish):
                (self.bonds.get(output.link) or self.links[output.link]).publish(output)
            else:
                self.does[type(output)](output)
        self.carried_out()

    def _way(self, link: str) -> Bond | MqttLink:
        return self.bonds.get(link) or self.links[link]

    def stood_still(self) -> None:
        """The process was not called for longer than `STALL_MS`: what its sockets have received may be old."""

    def carried_out(self) -> None:
        """Hook: all effects of one message, or of one tick, have been carried out."""

    def connected(self, link: str) -> None:
        self.carry_out(self.lists.on_connected(link))
        self.carry_out(self.role.on_connected(link, self.clock.now_ms()))

    def disconnected(self, link: str) -> None:
        self.lists.on_disconnected(link)
        self.carry_out(self.role.on_disconnected(link, self.clock.now_ms()))

    def received(self, link: str, message: Inbound) -> None:
        now_ms = self.clock.now_ms()
        if message.topic != self.lists.topic(link):
            self.carry_out(self.role.on_message(link, message, now_ms))
            return
        effects, is_newer = self.lists.on_message(link, message, now_ms)
        self.carry_out(effects)
        if is_newer:
            self._on_newer_list()

    def subscribed(self, subscribe: Subscribe) -> None:
        now_ms = self.clock.now_ms()
        if subscribe.ref == LISTS:
            self.lists.on_subscribed(subscribe.link, now_ms)
        else:
            self.carry_out(self.role.on_subscribed(subscribe, now_ms))

    def published(self, link: str, ref: Hashable, code: int) -> None:
        self.carry_out(self.role.on_published(link, ref, code, self.clock.now_ms()))

    def count(self, kind: str, detail: str) -> None:
        """Count an event that should not happen; the first of a kind is logged."""
        self.counts[kind] += 1
        if self.counts[kind] == 1:
            logger.warning("%s: %s (further ones are counted, not logged)", kind, detail)

    def _job_ended(self, job: asyncio.Task[Any]) -> None:
        """End the role if a job has failed: the error would pass unnoticed. The links stay up for the goodbye."""
        error = None if job.cancelled() else job.exception()
        if error is not None and not self._fail(error):
            logger.error("a job failed during shutdown: %r", error)

    def _fail(self, error: BaseException) -> bool:
        """End `run` with an error; returns False if it has ended already."""
        if self._stopped is None or self._stopped.done():
            return False
        self._stopped.set_exception(error)
        return True

    async def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            now_ms = self.clock.now_ms()
            if now_ms - self.ticked_ms > STALL_MS:
                self.stood_still()
            self.ticked_ms = now_ms
            self.carry_out(self.role.tick(now_ms))
            self.carry_out(self.lists.tick(now_ms))
            if now_ms - self._told_ms >= READY_TOUCH_S * 1000:
                self._told_ms = now_ms
                self._tell(self.role.is_ready(now_ms))
            due_s = next_tick(due_s, loop.time())
            await asyncio.sleep(due_s - loop.time())

    def _tell(self, is_ready: bool) -> None:
        if self._ready_file is not None:
            self._ready_file.tell(is_ready)
        if self.service is not None:
            self.service.alive(is_ready)

    async def _say_goodbye(self) -> None:
        if self.service is not None:
            self.service.ending()
        self.carry_out(self.role.goodbye(self.clock.now_ms()))
        await asyncio.gather(*(link.close() for link in self.links.values()))
        if self._ready_file is not None:
            await self._ready_file.close()
        if self.counts:
            logger.info("counted: %s", ", ".join(f"{kind} {n}" for kind, n in sorted(self.counts.items())))


def next_tick(due_s: float, now_s: float) -> float:
    """Time of the tick after the one due at `due_s`: on the same schedule, without the missed ones."""
    return due_s + TICK_S * max(1, ceil((now_s - due_s) / TICK_S))
