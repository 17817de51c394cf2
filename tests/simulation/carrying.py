"""Sensors, a drone's carrier, an activator's relay and a station's readings, connected by links that a test breaks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mqttxt.activator.drones import CLOUD, FOG
from mqttxt.activator.leases import Leases
from mqttxt.activator.part import Site
from mqttxt.activator.sensor_relay import Carried, SensorRelay
from mqttxt.core.channel import Channel
from mqttxt.core.effects import Inbound, Log, Publish
from mqttxt.core.session_owners import SessionOwners
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Acknowledge, ForgetReadings, LoadReadings, StoreReading
from mqttxt.drone.sensors.carrier import SENSORS, Carrier
from mqttxt.drone.sensors.store import Batch, Done, SensorStore
from mqttxt.protocol.codec import decode, encode
from mqttxt.protocol.control import Registration
from mqttxt.protocol.readings import Reading, ReadingMessage, checked
from mqttxt.protocol.topics import CloudSide, DroneTopic, FogSide
from mqttxt.station.outcomes import SensorReading
from mqttxt.station.readings import Readings

BOOT = 0xB007
LINK = "air"


def reading(seq: int = 0, sensor: int = 1, kind: str = "temperature", boot: int = BOOT, **more: Any) -> Reading:
    fields = {"boot": boot, "seq": seq, "time_ms": 1_767_225_600_000 + seq, "value": seq / 7, **more}
    return Reading(sensor, kind, ReadingMessage(**fields))


def inbound(of: Reading, receipt: tuple[int, int] | None = (1, 1)) -> Inbound:
    return Inbound(f"sensor{of.sensor}/{of.kind}", encode(of.message), 1, False, receipt)


def carried(effects: Iterable[Any]) -> list[int]:
    """The sequence numbers of the readings that are sent to the fog, in order."""
    found = [e for e in effects if isinstance(e, Publish) and e.link == LINK]
    return [decode(ReadingMessage, e.payload).seq for e in found]


@dataclass
class Way:
    """One drone's way to the station. Messages on a link that breaks are lost; `stored` was acknowledged to sensors."""

    path: Path
    limit: int = 1000
    now_ms: int = 0
    fog_is_up: bool = False
    to_fog: list[Publish] = field(default_factory=list)
    to_cloud: list[Publish] = field(default_factory=list)
    to_drone: list[Publish] = field(default_factory=list)
    to_store: Batch = field(default_factory=Batch)
    stored: set[int] = field(default_factory=set)
    heard: list[SensorReading] = field(default_factory=list)
    logs: list[Log] = field(default_factory=list)
    listens: bool = True
    says_nobody: bool = True
    """Whether the cloud broker reports that nobody subscribes."""

    def __post_init__(self) -> None:
        self.station = Readings()
        self.restart_activator()
        self.store: SensorStore | None = None
        self.restart_drone()

    def restart_activator(self) -> None:
        self.leases = Leases()
        to_cloud, to_fog = Channel(CLOUD, "", Settings()), Channel(FOG, "", Settings())
        owners = SessionOwners(self.leases.names)
        self.relay = SensorRelay(Site(1, to_cloud, to_fog, CloudSide(1), FogSide(), self.leases, owners))
        self.register()
        self.to_cloud.clear()
        self.to_drone.clear()

    def register(self) -> None:
        """Register the station, as long as it listens."""
        lease_s = 3600 if self.listens else 0
        self.leases.register(Registration(name="g", session=1, nonce=0, lease_s=lease_s), self.now_ms)

    def restart_drone(self) -> None:
        """Restart the client with the contents of its store alone."""
        if self.store is not None:
            self.store.close()
        self.store = SensorStore(self.path, self.limit)
        self.carrier = Carrier(1, Channel(LINK, "", Settings()), FogSide())
        self.to_store = Batch()
        self.cut()

    def cut(self) -> None:
        """Break the air link; messages on it are lost."""
        self.fog_is_up = False
        self.carrier.on_fog_down()
        self.to_fog.clear()
        self.to_drone.clear()

    def connect(self) -> None:
        if not self.fog_is_up:
            self.fog_is_up = True
            self.take(self.carrier.on_fog_up(self.now_ms))

    def measure(self, *seqs: int) -> None:
        for seq in seqs:
            self.take(self.carrier.on_message(inbound(reading(seq)), self.now_ms))

    def take(self, effects: Iterable[Any]) -> None:
        for effect in effects:
            if isinstance(effect, StoreReading):
                self.to_store.store.append(effect)
            elif isinstance(effect, ForgetReadings):
                self.to_store.forget += effect.keys
            elif isinstance(effect, LoadReadings):
                self.to_store.load = effect
            elif isinstance(effect, Log):
                self.logs.append(effect)
            elif isinstance(effect, Publish) and effect.link == LINK:
                self.to_fog.append(effect)
            elif isinstance(effect, Publish) and effect.link == CLOUD:
                self.to_cloud.append(effect)
            elif isinstance(effect, Publish) and effect.link == FOG:
                self.to_drone.append(effect)
            else:
                assert isinstance(effect, Acknowledge | Publish)
                assert effect.link == SENSORS

    def work(self) -> None:
        """Let the store carry out its batch."""
        assert self.store is not None
        batch, self.to_store = self.to_store, Batch()
        done: Done = self.store.carry_out(batch)
        self.stored |= {effect.reading.message.seq for effect in done.stored}
        self.take(self.carrier.on_stored(done.stored, self.now_ms) if done.stored else [])
        self.take(self.carrier.on_refused(done.refused, done.reason, self.now_ms))
        if batch.load is not None:
            self.take(self.carrier.on_loaded(done.rows, batch.load.most, self.now_ms))

    def to_the_activator(self, most: int = 1000) -> None:
        """Let up to `most` publishes cross the air."""
        for _ in range(min(most, len(self.to_fog))):
            publish = self.to_fog.pop(0)
            self.take(self.carrier.on_published(publish.ref, 0, self.now_ms))  # type: ignore[arg-type]
            self.take(
                self.relay.on_reading(
                    FogSide().parse(publish.topic), Inbound(publish.topic, publish.payload), self.now_ms
                )
            )

    def to_the_station(self, most: int = 1000) -> None:
        """Let up to `most` readings reach the cloud broker, and the station if it listens."""
        for _ in range(min(most, len(self.to_cloud))):
            publish = self.to_cloud.pop(0)
            code = 0x10 if self.says_nobody and not self.listens else 0
            if self.listens:
                topic = CloudSide(1).parse(publish.topic)
                assert isinstance(topic, DroneTopic)
                message = checked(topic.sensor, topic.name, decode(ReadingMessage, publish.payload))
                self.heard += self.station.on_reading(1, 1, message)
            assert isinstance(publish.ref, Carried)
            self.take(self.relay.on_published(publish.ref, code, self.now_ms))

    def back_to_the_drone(self, most: int = 1000) -> None:
        """Let up to `most` acknowledgements cross the air."""
        self.take(self.relay.tick(self.now_ms))
        for _ in range(min(most, len(self.to_drone))):
            ack = self.to_drone.pop(0)
            self.take(self.carrier.on_ack(Inbound(ack.topic, ack.payload, ack.qos), self.now_ms))

    def lose_the_cloud(self) -> None:
        """Break the activator's connection to the cloud broker; messages on it are lost."""
        self.to_cloud.clear()
        self.relay.on_cloud_down()

    def fly(self) -> None:
        """Deliver everything all the way, and acknowledgements back."""
        self.to_the_activator()
        self.to_the_station()
        self.back_to_the_drone()

    def pass_time(self, milliseconds: int) -> None:
        self.now_ms += milliseconds
        self.take(self.carrier.tick(self.now_ms))

    def settle(self) -> None:
        """Let everything work until all is delivered, for at most five minutes."""
        self.connect()
        assert self.store is not None
        for _ in range(300):
            if not (self.to_store or self.to_fog or self.to_cloud or self.to_drone or len(self.store)):
                return
            self.work()
            self.fly()
            self.pass_time(1000)
