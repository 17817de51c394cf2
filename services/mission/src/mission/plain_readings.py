"""Sensors' readings from a plain MQTT broker, for a fleet whose protocol cannot carry them."""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import Callable, Hashable

from mqttxt.core.address import BrokerAddress
from mqttxt.core.effects import Inbound, Subscribe
from mqttxt.core.mqtt.link import MqttLink
from mqttxt.errors import MqttxtError, PayloadError
from mqttxt.protocol.codec import decode
from mqttxt.protocol.readings import ReadingMessage, checked
from mqttxt.protocol.topics import CloudSide, DroneTopic

from .fleet import MissionError, Reading

logger = logging.getLogger("mission.readings")
LINK = "readings"


class PlainReadings:
    """A QoS 1 subscriber to `fogX/droneY/sensorS/K` at a cloud broker, to which bridges forward readings.

    Raises mqttxt.ConfigurationError for an invalid broker address. `on_reading` gets each reading once. `on_lost` is
    called when no more will arrive, because the broker refuses; `lost` has the reason.
    """

    def __init__(
        self,
        broker: str,
        fogs: tuple[int, ...],
        on_reading: Callable[[int, Reading], None],
        on_lost: Callable[[], None],
    ) -> None:
        self._address = BrokerAddress.parse(broker, "--sensor-broker")
        self._sides = {fog: CloudSide(fog) for fog in fogs}
        self._on_reading = on_reading
        self._on_lost = on_lost
        self.lost: BaseException | None = None
        self._heard: set[Reading] = set()
        self._link: MqttLink | None = None
        self._running: asyncio.Task[None] | None = None
        self._subscribed = asyncio.Event()

    @property
    def missing(self) -> list[str]:
        """What connecting still waits for."""
        return [] if self._subscribed.is_set() else [f"{self._address} does not answer"]

    async def connect(self) -> None:
        """Return when all is subscribed. Raises MissionError if the broker refuses."""
        client_id = f"mission-readings-{secrets.token_hex(4)}"
        self._link = MqttLink(LINK, self._address, client_id, None, self)
        self._running = asyncio.create_task(self._link.run())
        self._running.add_done_callback(self._ended)
        waiting = asyncio.create_task(self._subscribed.wait())
        try:
            await asyncio.wait({waiting, self._running}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            waiting.cancel()
        if isinstance(self.lost, MqttxtError):
            raise MissionError(f"connect: {self.lost}") from self.lost

    async def close(self) -> None:
        if self._link is not None:
            await self._link.close()
        if self._running is not None:
            self._running.cancel()
            await asyncio.wait({self._running})

    def _ended(self, running: asyncio.Task[None]) -> None:
        self.lost = None if running.cancelled() else running.exception()
        if self.lost is not None:
            self._on_lost()

    def connected(self, link: str) -> None:
        assert self._link is not None
        self._link.subscribe(Subscribe(LINK, tuple(f"{side.root}+/+/+" for side in self._sides.values())))

    def disconnected(self, link: str) -> None:
        logger.warning("%s: connection lost", self._address)

    def subscribed(self, subscribe: Subscribe) -> None:
        self._subscribed.set()

    def published(self, link: str, ref: Hashable, code: int) -> None:
        """This client publishes nothing."""

    def count(self, kind: str, detail: str) -> None:
        logger.warning("%s: %s", kind, detail)

    def received(self, link: str, message: Inbound) -> None:
        """Report a new reading; a bridge may forward one twice."""
        try:
            fog, reading = self._read(message)
        except PayloadError as error:
            logger.warning("%s: %s", message.topic, error)
            return
        if reading not in self._heard:
            self._heard.add(reading)
            self._on_reading(fog, reading)

    def _read(self, message: Inbound) -> tuple[int, Reading]:
        for fog, side in self._sides.items():
            if message.topic.startswith(side.root):
                topic = side.parse(message.topic)
                if isinstance(topic, DroneTopic) and topic.kind == "sensor":
                    told = decode(ReadingMessage, message.payload)
                    return fog, Reading(
                        drone=topic.drone,
                        sensor=topic.sensor,
                        boot=told.boot,
                        seq=told.seq,
                        kind=topic.name,
                        value=told.value,
                        unit=checked(topic.sensor, topic.name, told).unit,
                        time_ms=told.time_ms,
                    )
        raise PayloadError("not a sensor's topic", "topic")
