"""The sensors' side of a UAV client: the drone's own broker, the connection to it, and the store, in its own thread.

A disk may need a tenth of a second to confirm a write, and the aircraft does not wait for that.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.address import BrokerAddress
from ...core.effects import Receipt
from ...core.embedded_broker import EmbeddedBroker
from ...core.mqtt.events import LinkEvents
from ...core.mqtt.link import MqttLink
from ...errors import BrokerRefused
from ...security.identity import Identity
from ...security.revocation import RevocationList
from ..effects import Acknowledge, ForgetReadings, LoadReadings, StoreReading
from . import DEFAULT_LIMIT
from .carrier import SENSORS, Carrier
from .store import Batch, Done, SensorStore

logger = logging.getLogger("mqttxt.sensors")

KEPT_BY_BROKER_S = 3600
"""How long the drone's broker keeps readings for this client while it is not connected."""
PAUSE_S = 1.0
"""The pause after an error of the store, so that a full disk is not tried all the time."""


@dataclass(frozen=True)
class SensorOptions:
    """Where sensors publish (an embedded broker, or one that runs elsewhere) and where their readings are kept."""

    broker: BrokerAddress
    store: Path
    limit: int = DEFAULT_LIMIT
    embedded: EmbeddedBroker | None = None


class Receipts:
    """Acknowledges inbound messages in the order of receipt (MQTT 5.0, 4.6), whatever the order of their storage."""

    def __init__(self, acknowledge: Callable[[Receipt], None]) -> None:
        self._acknowledge = acknowledge
        self._waiting: dict[Receipt, bool] = {}

    def wait(self, receipt: Receipt) -> None:
        """Hold back the acknowledgements of this and all later messages."""
        self._waiting[receipt] = False

    def release(self, receipt: Receipt) -> None:
        """Let a message be acknowledged, whether it had to wait or not."""
        self._waiting[receipt] = True
        while self._waiting:
            first = next(iter(self._waiting))
            if not self._waiting[first]:
                return
            del self._waiting[first]
            self._acknowledge(first)


class SensorPort:
    """Carries out the effects of a Carrier. Raises ConfigurationError for a store that cannot be used.

    No fault of the sensors' side ends the UAV client.
    """

    def __init__(
        self,
        options: SensorOptions,
        carrier: Carrier,
        drone: int,
        events: LinkEvents,
        carry_out: Callable[[Iterable[Any]], None],
        now_ms: Callable[[], int],
        identity: Identity | None = None,
    ) -> None:
        self._embedded = options.embedded
        self._store = SensorStore(options.store, options.limit)
        self._carrier = carrier
        self._carry_out = carry_out
        self._now_ms = now_ms
        self._batch = Batch()
        self._due = asyncio.Event()
        self.link = MqttLink(
            SENSORS,
            options.broker,
            f"mqttxt-drone{drone}-sensors",
            None,
            events,
            manual_ack=True,
            session_expiry_s=KEPT_BY_BROKER_S,
            identity=identity,
            may_be_ended=identity is None,
        )
        self._receipts = Receipts(self.link.acknowledge)
        self.does: dict[type[Any], Callable[[Any], object]] = {
            StoreReading: self._store_reading,
            ForgetReadings: self._forget_readings,
            LoadReadings: self._load_readings,
            Acknowledge: lambda effect: self._receipts.release(effect.receipt),
        }
        """The function that carries out each kind of the carrier's effects."""

    def jobs(self) -> list[Coroutine[Any, Any, None]]:
        """The coroutines that run as long as the UAV client does."""
        embedded = [self._embedded.run(waits=True)] if self._embedded is not None else []
        return [*embedded, self._keep_link(), self._work()]

    def reload(self, newest: RevocationList) -> None:
        """Reload the embedded broker, if there is one."""
        if self._embedded is not None:
            self._embedded.reload(newest)

    def _store_reading(self, effect: StoreReading) -> None:
        self._batch.store.append(effect)
        if effect.receipt is not None:
            self._receipts.wait(effect.receipt)
        self._due.set()

    def _forget_readings(self, effect: ForgetReadings) -> None:
        self._batch.forget += effect.keys
        self._due.set()

    def _load_readings(self, effect: LoadReadings) -> None:
        self._batch.load = effect
        self._due.set()

    async def _keep_link(self) -> None:
        try:
            await self.link.run()
        except BrokerRefused as error:
            logger.error("%s; no reading is taken in until this UAV client is started again", error)

    async def _work(self) -> None:
        """Run one transaction after the other; effects that arrive meanwhile go into the next one."""
        loop = asyncio.get_running_loop()
        try:
            with ThreadPoolExecutor(1, "sensor-store") as thread:
                while True:
                    await self._due.wait()
                    self._due.clear()
                    batch, self._batch = self._batch, Batch()
                    done = await loop.run_in_executor(thread, self._store.carry_out, batch)
                    self._report(batch, done)
                    if done.failed:
                        await asyncio.sleep(PAUSE_S)
        finally:
            self._store.close()

    def _report(self, batch: Batch, done: Done) -> None:
        now_ms = self._now_ms()
        if done.failed and batch.forget:
            self._batch.forget = batch.forget + self._batch.forget
            self._due.set()
        if done.stored:
            self._carry_out(self._carrier.on_stored(done.stored, now_ms))
        if done.refused:
            self._carry_out(self._carrier.on_refused(done.refused, done.reason, now_ms))
        if batch.load is not None:
            most = batch.load.most if not done.failed else 0
            self._carry_out(self._carrier.on_loaded(done.rows, most, now_ms))
