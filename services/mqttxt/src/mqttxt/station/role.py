"""The ground station as a state machine: registrations, commands and their outcomes (docs/protocol.md)."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any

from ..core.effects import Inbound, Log, Publish, Subscribe, Will
from ..core.settings import Rebirth, Settings
from ..errors import FogUnreachable, PayloadError
from ..protocol.bundles import FogBundle, states_of
from ..protocol.codec import decode, encode
from ..protocol.messages import (
    BeaconMessage,
    Control,
    DroneRecord,
    FogPresence,
    FogResultMessage,
    Presence,
    ResultMessage,
)
from ..protocol.rankings import PsmiMessage, QodsMessage
from ..protocol.readings import ReadingMessage, checked
from ..protocol.state_payload import decode_state
from ..protocol.topics import CloudSide, DroneTopic, FogTopic, check_prefix, station_of, station_reachable
from .commands import Output, StationCommands
from .fog import LINK, FogView
from .readings import Readings

DEFAULT_LEASE_S = 30


class StationRole:
    """One ground station session. Times are milliseconds of its session clock."""

    def __init__(
        self,
        name: str,
        session: int,
        settings: Settings,
        *,
        prefix: str = "",
        lease_s: int = DEFAULT_LEASE_S,
        control: bool = True,
    ) -> None:
        self.name = name
        self.session = session
        self.settings = settings
        self.fogs: dict[int, FogView] = {}
        self.commands = StationCommands(session, settings)
        self.readings = Readings()
        self.connected = False
        self._prefix = check_prefix(prefix)
        self._lease_s = lease_s
        self._control = Control.WANT if control else Control.NONE
        self._presence_topic = station_reachable(name, prefix)
        self._rebirth = Rebirth()

    def will(self) -> Will:
        """One will serves all fogs of the station."""
        return Will(self._presence_topic, self._presence(up=False))

    def is_ready(self, now_ms: int) -> bool:
        """Whether it is connected to the cloud broker."""
        return self.connected

    def on_connected(self, link: str, now_ms: int) -> list[Output]:
        self.connected = True
        out: list[Output] = [Subscribe(LINK, (self._presence_topic,), ref=None)]
        return out + [self._subscribe(fog) for fog in self.fogs.values()]

    def on_disconnected(self, link: str, now_ms: int) -> list[Output]:
        self.connected = False
        out: list[Output] = []
        for fog in self.fogs.values():
            fog.subscribed = fog.up = fog.registered = False
            out += fog.tick(now_ms)[1]
        return out

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Output]:
        if subscribe.ref is None:
            return [self._birth(up=True)]
        fog = self.fogs[int(str(subscribe.ref))]
        fog.subscribed = True
        return [fog.registration(now_ms)] if fog.up else []

    def add_fogs(self, numbers: Iterable[int]) -> list[Output]:
        """Take part in more fogs: subscribe, register, and keep the registrations."""
        out: list[Output] = []
        for number in numbers:
            if number in self.fogs:
                continue
            topics = CloudSide(number, self._prefix)
            fog = FogView(topics, self.name, self.session, self._lease_s, self.settings, self._control)
            self.fogs[number] = fog
            if self.connected:
                out.append(self._subscribe(fog))
        return out

    def take_over(self, fog_number: int, drones: tuple[int, ...] | None, now_ms: int) -> list[Output]:
        """Take control of a fog's drones (None: of all), whoever holds it; raises FogUnreachable."""
        fog = self.fog(fog_number, "takeover")
        if not fog.registered or not fog.is_live(now_ms):
            raise FogUnreachable(f"fog {fog_number}: no live activator; control was not taken")
        return [fog.registration(now_ms, take=True, drones=drones)]

    def fog(self, number: int, unsent: str | None = None) -> FogView:
        """A fog that this station takes part in; raises FogUnreachable for another, naming what was not sent."""
        if number not in self.fogs:
            raise FogUnreachable(f"fog {number}: connect to it first{f'; {unsent} was not sent' if unsent else ''}")
        return self.fogs[number]

    def on_message(self, link: str, message: Inbound, now_ms: int) -> list[Output]:
        """A message from the cloud broker; what does not follow the specification is counted."""
        try:
            if station_of(message.topic, self._prefix) is not None:
                return self._on_own_presence(decode(Presence, message.payload), now_ms)
            for fog in self.fogs.values():
                if message.topic.startswith(fog.topics.root):
                    return self._on_fog_message(fog, fog.topics.parse(message.topic), message, now_ms)
            raise PayloadError(f"topic {message.topic!r}: not of a fog that was asked for", "topic")
        except PayloadError as error:
            return [Log(error.kind, f"{message.topic}: {error}")]

    def on_published(self, link: str, ref: Hashable, code: int, now_ms: int) -> list[Output]:
        """A command is acknowledged by its executor's words, not by the broker."""
        return []

    def tick(self, now_ms: int) -> list[Output]:
        """Everything that is due by time; to be called at least ten times a second."""
        out: list[Output] = []
        for fog in self.fogs.values():
            effects, events = fog.tick(now_ms)
            out += [*effects, *events]
        if self._rebirth.is_due(now_ms):
            out.append(self._birth(up=True))
        return out + self.commands.tick(self.fogs, now_ms)

    def goodbye(self, now_ms: int) -> list[Output]:
        """A clean stop ends the leases and says that the station is gone."""
        if not self.connected:
            return []
        ends: list[Output] = [fog.registration(now_ms, lease_s=0) for fog in self.fogs.values() if fog.registered]
        return [*ends, self._birth(up=False)]

    def _on_fog_message(self, fog: FogView, topic: Any, message: Inbound, now_ms: int) -> list[Output]:
        if isinstance(topic, DroneTopic) and topic.kind == "state":
            return [*fog.on_state(topic.drone, decode_state(topic.name, message.payload, relayed=True), now_ms)]
        if isinstance(topic, DroneTopic) and topic.kind == "sensor":
            reading = checked(topic.sensor, topic.name, decode(ReadingMessage, message.payload))
            return [*self.readings.on_reading(fog.number, topic.drone, reading)]
        if isinstance(topic, DroneTopic) and topic.kind == "reachable":
            return [*fog.on_record(topic.drone, decode(DroneRecord, message.payload), now_ms)]
        if isinstance(topic, DroneTopic) and topic.kind == "commands_result":
            return self.commands.on_result(fog, topic.drone, decode(ResultMessage, message.payload), now_ms)
        if isinstance(topic, FogTopic) and topic.kind == "commands_result":
            return self.commands.on_fog_result(fog, decode(FogResultMessage, message.payload), now_ms)
        if isinstance(topic, FogTopic) and topic.kind == "states":
            pairs = states_of(decode(FogBundle, message.payload))
            return [event for drone, state in pairs for event in fog.on_state(drone, state, now_ms)]
        if isinstance(topic, FogTopic) and topic.kind == "QoDS":
            return [*fog.on_qods(decode(QodsMessage, message.payload))]
        if isinstance(topic, FogTopic) and topic.kind == "PSMI":
            return self.commands.on_psmi(fog, decode(PsmiMessage, message.payload), now_ms)
        if isinstance(topic, FogTopic) and topic.kind == "clock":
            events, confirmed = fog.on_beacon(decode(BeaconMessage, message.payload), now_ms)
            return [*events, *(self.commands.ask_again(fog.number) if confirmed else [])]
        if isinstance(topic, FogTopic) and topic.kind == "reachable":
            effects, events = fog.on_presence(decode(FogPresence, message.payload), now_ms)
            return [*effects, *events]
        raise PayloadError(f"topic {message.topic!r}: not for a ground station", "topic")

    def _on_own_presence(self, presence: Presence, now_ms: int) -> list[Output]:
        if self.connected and (presence.session != self.session or not presence.up):
            self._rebirth.arm(now_ms)
        return []

    def _subscribe(self, fog: FogView) -> Subscribe:
        return Subscribe(LINK, fog.topics.station_filters(), ref=fog.number)

    def _presence(self, up: bool) -> bytes:
        return encode(Presence(session=self.session, up=up), self.settings.encoding)

    def _birth(self, up: bool) -> Publish:
        return Publish(LINK, self._presence_topic, self._presence(up), qos=1, retain=True)
