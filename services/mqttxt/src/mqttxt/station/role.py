"""The ground station as a state machine: registrations, commands and their outcomes (docs/protocol.md)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import TYPE_CHECKING, Any

from ..core.channel import Channel
from ..core.effects import Inbound, Log, Subscribe, Will
from ..core.hearing import Hearing
from ..core.own_presence import OwnPresence
from ..core.settings import Settings
from ..errors import ConfigurationError, FogUnreachable, PayloadError
from ..protocol.bulk import BulkAnswer
from ..protocol.codec import decode
from ..protocol.control import Control, DroneRecord
from ..protocol.messages import BeaconMessage, FogPresence, FogResultMessage, Presence
from ..protocol.names import MAX_DRONE, check_number, check_prefix
from ..protocol.rankings import PsmiMessage, QodsMessage
from ..protocol.readings import MOST_ACKNOWLEDGED, ReadingAck, ReadingKey, ReadingMessage, checked
from ..protocol.topics import REVOKED, CloudSide, DroneTopic, FogSide, FogTopic, Topic, station_reachable
from ..security.cose import SIGNED
from ..security.rights import TAKE_OVER
from .commands import Output, StationCommands
from .drone_words import DroneWords, apart
from .fog import LINK, FogView
from .list_watch import ListWatch
from .outcomes import ListBehind, Outcome
from .readings import Readings
from .transfers import Transfers

if TYPE_CHECKING:
    from ..security.seal import Seal

Handler = Callable[[FogView, Any, Inbound, int], Iterable[Output]]


class StationRole:
    """One ground station session. Times are milliseconds of its session clock. With a `seal` messages are signed."""

    def __init__(
        self,
        name: str,
        session: int,
        settings: Settings,
        *,
        prefix: str = "",
        control: bool | Iterable[int] = True,
        seal: Seal | None = None,
    ) -> None:
        self.name = name
        self.session = session
        self.settings = settings
        self.fogs: dict[int, FogView] = {}
        self._channel = Channel(LINK, check_prefix(prefix), settings, seal)
        self.commands = StationCommands(session, self._channel)
        self.readings = Readings(by_sensor=seal is not None and seal.signs_readings)
        self.transfers = Transfers(session, self._channel)
        self.connected = False
        self.prefix = check_prefix(prefix)
        self._control = Control.WANT if control is True else Control.NONE
        wanted = () if isinstance(control, bool) else control
        if not isinstance(wanted, Iterable):
            raise ConfigurationError(f"control {wanted!r}: expected True, False or drones' numbers, as [1, 3]")
        self._wanted = frozenset(check_number("drone", drone, MAX_DRONE) for drone in wanted)
        self._presence = OwnPresence(self._channel, station_reachable(name, prefix), session)
        self._hearing = Hearing(LINK, lambda: [self._presence.say(up=True)])
        self._heard: dict[tuple[int, int], list[ReadingKey]] = {}
        self._words = DroneWords(self._channel)
        self._lists = ListWatch(f"gs-{name}")
        self._handlers = self._made_handlers(self.signs)

    @property
    def signs(self) -> bool:
        """Whether messages are signed."""
        return self._channel.seal is not None

    def is_doubtful(self, outcome: Outcome) -> bool:
        """Whether a word lacks its drone's signature in a fleet that signs: the command may have reached the drone."""
        return self.signs and outcome.signer != f"drone{outcome.drone}"

    @property
    def lists_topic(self) -> str:
        """The cloud broker's topic of the fleet's revocation list."""
        return f"{self.prefix}{REVOKED}"

    def will(self) -> Will:
        """One will serves all fogs of the station."""
        return self._presence.will()

    def is_ready(self, now_ms: int) -> bool:
        """Whether it is connected to the cloud broker."""
        return self.connected

    def on_connected(self, link: str, now_ms: int) -> list[Output]:
        self.connected = True
        if self.fogs:
            self._hearing.connected(now_ms)
        return self._subscribed_to([*self.fogs.values()], is_first=True)

    def on_disconnected(self, link: str, now_ms: int) -> list[Output]:
        self.connected = False
        self._hearing.end()
        out: list[Output] = []
        for fog in self.fogs.values():
            fog.subscribed = fog.up = fog.registered = False
            out += fog.tick(now_ms)[1]
        return out

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Output]:
        if subscribe.ref is None:
            self._hearing.granted(now_ms)
            return [self._presence.say(up=True)]
        return [*self.fogs[int(str(subscribe.ref))].on_subscribed(now_ms)]

    def add_fogs(self, numbers: Iterable[int]) -> list[Output]:
        """Take part in more fogs: subscribe, register, and keep the registrations."""
        is_first, added = not self.fogs, []
        for number in numbers:
            if number in self.fogs:
                continue
            topics = CloudSide(number, self.prefix)
            fog = FogView(topics, self.name, self.session, self._channel, self._control)
            fog.claimed |= self._wanted
            self.fogs[number] = fog
            added.append(fog)
        return self._subscribed_to(added, is_first) if self.connected else []

    def take_over(self, fog_number: int, drones: tuple[int, ...] | None, now_ms: int) -> list[Output]:
        """Take control of a fog's drones (None: of all) from any holder.

        Raises FogUnreachable without a live activator, ConfigurationError where the certificate does not allow it.
        """
        fog = self.fog(fog_number, "takeover")
        seal = self._channel.seal
        if seal is not None and not seal.certificate.rights.take_over:
            raise ConfigurationError(f"takeover: {seal.name}'s certificate has no {TAKE_OVER}; control was not taken")
        if not fog.registered or not fog.is_live(now_ms):
            raise FogUnreachable(f"fog {fog_number}: no live activator; control was not taken")
        return [fog.registration(now_ms, take=True, drones=drones)]

    def claim(self, fog_number: int, drone: int, wanted: bool, now_ms: int) -> list[Output]:
        """Claim control of a drone, or release it; raises ConfigurationError where the station wants all drones."""
        fog = self.fog(fog_number)
        if fog.control is not Control.NONE:
            raise ConfigurationError(f"drone {drone}: expected a station with control=False; this one wants all drones")
        return [*fog.claim(drone, wanted, now_ms)]

    def fog(self, number: int, unsent: str | None = None) -> FogView:
        """A fog that this station takes part in; raises FogUnreachable for another. `unsent`: what was not sent."""
        if number not in self.fogs:
            raise FogUnreachable(f"fog {number}: connect to it first{f'; {unsent} was not sent' if unsent else ''}")
        return self.fogs[number]

    def on_message(self, link: str, message: Inbound, now_ms: int) -> list[Output]:
        """Take a message from the cloud broker; one that breaks the specification is counted and dropped."""
        self._hearing.heard(now_ms)
        try:
            if message.topic == self._presence.topic:
                return self._on_own_presence(message, now_ms)
            for fog in self.fogs.values():
                if message.topic.startswith(fog.topics.root):
                    topic = fog.topics.parse(message.topic)
                    take = self._handlers.get((type(topic), topic.kind))
                    if take is None:
                        raise PayloadError(f"topic {message.topic!r}: not for a ground station", "topic")
                    return [*take(fog, topic, message, now_ms)]
            raise PayloadError(f"topic {message.topic!r}: not of a fog that was asked for", "topic")
        except PayloadError as error:
            return [Log(error.kind, f"{message.topic}: {error}")]

    def on_published(self, link: str, ref: Hashable, code: int, now_ms: int) -> list[Output]:
        """A command is acknowledged by its executor's words, not by the broker."""
        self._hearing.published(ref, code, now_ms)
        return []

    def on_identity(self, now_ms: int) -> list[Output]:
        """The identity has another key, or its fleet a newer revocation list: publish a birth that has it."""
        if self._channel.seal is None:
            return []
        if self._channel.seal.on_identity():
            self.commands.sign_again()
        return [self._presence.say(up=True)] if self.connected and self.fogs else []

    def tick(self, now_ms: int) -> list[Output]:
        """Everything that is due by time; call it at least ten times per second."""
        out: list[Output] = []
        for fog in self.fogs.values():
            effects, events = fog.tick(now_ms)
            out += [*effects, *events]
        if self._presence.rebirth.is_due(now_ms):
            out.append(self._presence.say(up=True))
        out += self._hearing.tick(now_ms)
        return [*out, *self._acknowledge(), *self.commands.tick(self.fogs, now_ms), *self.transfers.tick(now_ms)]

    def _acknowledge(self) -> list[Output]:
        """Acknowledge the readings received since the last call, repeated ones too: only then do drones delete them."""
        heard, self._heard = self._heard, {}
        out: list[Output] = []
        for (number, drone), keys in heard.items():
            for start in range(0, len(keys), MOST_ACKNOWLEDGED):
                ack = ReadingAck(readings=tuple(keys[start : start + MOST_ACKNOWLEDGED]))
                topic = self.fogs[number].topics.drone_sensor_ack(drone)
                signed_as = FogSide().sensor_ack(drone)
                out.append(self._channel.publish(topic, ack, qos=1, signed_as=signed_as))
        return out

    def goodbye(self, now_ms: int) -> list[Output]:
        """End the leases and publish `down`, at a clean stop."""
        self._hearing.end()
        if not (self.connected and self.fogs):
            return []
        ends: list[Output] = [fog.registration(now_ms, lease_s=0) for fog in self.fogs.values() if fog.registered]
        return [*ends, self._presence.say(up=False)]

    def _made_handlers(self, signs: bool) -> dict[tuple[type[Topic], str], Handler]:
        """The handlers of a fog's messages, by their topic."""
        handlers: dict[tuple[type[Topic], str], Handler] = {
            (DroneTopic, "bulk_answer"): self._on_bulk_answer,
            (DroneTopic, "commands_result"): self._on_result,
            (DroneTopic, "reachable"): self._on_record,
            (DroneTopic, "sensor"): self._on_reading,
            (DroneTopic, "state"): FogView.on_states,
            (FogTopic, "PSMI"): self._on_psmi,
            (FogTopic, "QoDS"): self._on_qods,
            (FogTopic, "clock"): self._on_beacon,
            (FogTopic, "commands_result"): self._on_fog_result,
            (FogTopic, "reachable"): self._on_presence,
            (FogTopic, "states"): FogView.on_states,
        }
        if signs:
            handlers |= {(DroneTopic, kind): self._on_drones_own for kind in ("birth", "clock")}
        return handlers

    def _on_fog_result(self, fog: FogView, topic: FogTopic, message: Inbound, now_ms: int) -> list[Output]:
        if self.signs and (words := apart(fog, topic, message)) is not None:
            return [output for word in words for output in self.on_message(LINK, word, now_ms)]
        result = decode(FogResultMessage, self._channel.opened(message, fog.name))
        if self.signs and result.words is not None:
            raise PayloadError(f"words in the name of {fog.name}: expected each as it was signed", "forged")
        out = self.commands.on_fog_result(fog, result, now_ms)
        for word in result.words or ():
            out += self.commands.on_result(fog, word.drone, word.result(result), now_ms)
        return out

    def _on_psmi(self, fog: FogView, topic: FogTopic, message: Inbound, now_ms: int) -> list[Output]:
        return self.commands.on_psmi(fog, decode(PsmiMessage, self._channel.opened(message, fog.name)), now_ms)

    def _on_beacon(self, fog: FogView, topic: FogTopic, message: Inbound, now_ms: int) -> list[Output]:
        beacon = decode(BeaconMessage, self._channel.opened(message, fog.name))
        events, confirmed = fog.on_beacon(beacon, now_ms)
        asked = self.commands.ask_again(fog.number, now_ms) if confirmed else []
        return [*events, *asked, *self._on_list(fog, fog.name, beacon.revoked, now_ms)]

    def _on_presence(self, fog: FogView, topic: FogTopic, message: Inbound, now_ms: int) -> list[Output]:
        fog.is_signed = message.payload.startswith(SIGNED)
        presence = decode(FogPresence, self._channel.opened(message, fog.name))
        effects, events = fog.on_presence(presence, now_ms)
        is_live = self.signs and effects and not message.retain
        own = [self._presence.say(up=True)] if is_live else []  # the broker may not show it to an activator that starts
        behind = self._on_list(fog, fog.name, presence.revoked, now_ms) if presence.up else []
        return [*own, *effects, *events, *behind]

    def _on_qods(self, fog: FogView, topic: FogTopic, message: Inbound, now_ms: int) -> list[Output]:
        ranking = decode(QodsMessage, self._channel.opened_dated(message, fog.name, fog.clock, now_ms))
        return [*fog.on_qods(ranking, now_ms)]

    def _on_record(self, fog: FogView, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Output]:
        record = decode(DroneRecord, self._channel.opened(message, fog.name))
        return [*fog.on_record(topic.drone, record, now_ms)]

    def _on_reading(self, fog: FogView, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Output]:
        payload = self._channel.opened_reading(message.payload, topic.sensor, topic.name)
        reading = checked(topic.sensor, topic.name, decode(ReadingMessage, payload))
        if self.signs and fog.registered:
            self._heard.setdefault((fog.number, topic.drone), []).append(reading.key)
        return [*self.readings.on_reading(fog.number, topic.drone, reading)]

    def _on_result(self, fog: FogView, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Output]:
        result, signer = self._words.result(fog.name, topic, message)
        return self.commands.on_result(fog, topic.drone, result, now_ms, signer)

    def _on_bulk_answer(self, fog: FogView, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Output]:
        answer = decode(BulkAnswer, self._words.answer(topic, message))
        return [*self.transfers.on_answer(fog, topic.drone, answer, now_ms)]

    def _on_drones_own(self, fog: FogView, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Output]:
        """Take what a drone signed and its activator passed on: its birth, with the certificate, and its beacons."""
        seal = self._channel.seal
        assert seal is not None
        is_birth = topic.kind == "birth"
        said_on = FogSide().reachable(topic.drone) if is_birth else fog.topics.signed_drone_clock(topic.drone)
        signed = seal.open(said_on, message.payload, f"drone{topic.drone}")
        if topic.kind == "clock":
            beacon = decode(BeaconMessage, signed.payload)
            events = fog.on_drone_beacon(topic.drone, beacon, now_ms)
            return [*events, *self._on_list(fog, signed.signer, beacon.revoked, now_ms)]
        return [*self._on_list(fog, signed.signer, decode(Presence, signed.payload).revoked, now_ms)]

    def _on_list(self, fog: FogView, node: str, number: int | None, now_ms: int) -> list[ListBehind]:
        """Note which revocation list a node has, by its own signed message."""
        own = self._channel.list_number
        return self._lists.observe(fog.number, node, number, own, now_ms) if own is not None else []

    def _on_own_presence(self, message: Inbound, now_ms: int) -> list[Output]:
        if not self._presence.is_shown(message) and self.connected:
            self._presence.rebirth.arm(now_ms)
        return []

    def _subscribed_to(self, fogs: list[FogView], is_first: bool) -> list[Output]:
        """Subscribe to fogs, and before the first one to the station's own birth: without fogs it publishes none."""
        signed = self._channel.seal is not None
        own: list[Output] = [Subscribe(LINK, (self._presence.topic,), ref=None)] if is_first and fogs else []
        return own + [Subscribe(LINK, fog.topics.station_filters(signed), ref=fog.number) for fog in fogs]
