"""The activator of one fog: gate, presence and command relay between two brokers, as a state machine."""

from __future__ import annotations

import secrets
from typing import Any

from ..core.channel import Channel
from ..core.effects import Effect, Inbound, Log, Publish, Stop, Subscribe, Unsubscribe, Will
from ..core.session_owners import SessionOwners
from ..core.settings import Rebirth, Settings
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.messages import BeaconMessage, DroneRecord, FogPresence, Grant, Presence, Registration
from ..protocol.topics import CloudSide, DroneTopic, FogSide, FogTopic, StationTopic
from ..security.cose import Envelope
from ..security.seal import Seal
from .births import Births
from .command_relay import Relay
from .drones import CLOUD, FOG, Drones
from .leases import Leases
from .registrations import SignedRegistrations, is_question
from .selector import Selector
from .sensor_relay import Carried, SensorRelay
from .state_relay import StateRelay

CHALLENGE_MS = 3000
"""How long another live activator of this fog has to answer before this one takes its place."""
MOST_STATIONS = 1000
"""Registrations at a time; who is not answered is not registered."""
_ASKING = frozenset({"commands", "select", "init_connect"})
"""What is left to the activator that may own the fog already."""


class Activator:
    """One activator session. Times are milliseconds of its session clock. With a `seal` messages are signed."""

    def __init__(
        self,
        fog: int,
        session: int,
        settings: Settings,
        *,
        drones: tuple[int, ...] = (),
        broker: str | None = None,
        cloud: CloudSide | None = None,
        fog_side: FogSide | None = None,
        seal: Seal | None = None,
    ) -> None:
        self.fog = fog
        self.session = session
        self.settings = settings
        self.cloud = cloud or CloudSide(fog)
        self.fog_side = fog_side or FogSide()
        self.leases = Leases(drones)
        self._to_cloud = Channel(CLOUD, self.cloud.prefix, settings, seal)
        self._to_fog = Channel(FOG, self.fog_side.root, settings, seal)
        self._owners = SessionOwners()
        topics, channels = (self.cloud, self.fog_side), (self._to_cloud, self._to_fog)
        self.drones = Drones(session, *channels, *topics, drones, self.leases)
        self.relay = Relay(session, *channels, *topics, self.drones, self.leases, self._owners)
        self.selector = Selector(session, self._to_cloud, self.cloud, self.drones, self.leases, self.relay)
        self.states = StateRelay(session, self._to_cloud, self.cloud, self.drones, self.leases)
        self.sensors = SensorRelay(self._to_fog, self.cloud, self.fog_side, self.leases)
        self._births = Births(*topics, self.drones, self.leases)
        self._registrations = SignedRegistrations(session, seal, self._owners) if seal is not None else None
        self._seal = seal
        self._name = f"fog{fog}"
        self.connected = {CLOUD: False, FOG: False}
        self.born = False
        self._was_born = False
        self._broker = broker
        self._subacks = {CLOUD: 0, FOG: 0}
        self._next_beacon_ms = 0
        self._rival: int | None = None
        self._challenge_until_ms: int | None = None
        self._challenge_nonce = 0
        self._rebirth = Rebirth()

    def will(self) -> Will:
        """The will of the connection to the cloud broker; the fog broker needs none."""
        return Will(self.cloud.reachable, self._to_cloud.payload(self.cloud.reachable, self._presence(up=False)))

    def is_ready(self, now_ms: int) -> bool:
        """Whether the activator is live on both brokers."""
        return self.born and self.connected[FOG] and self._subacks[FOG] == 0

    def on_connected(self, link: str, now_ms: int) -> list[Effect]:
        self.connected[link] = True
        if link == FOG:
            self._subacks[FOG] = 1
            return [Subscribe(FOG, self.fog_side.activator_filters())]
        self._subacks[CLOUD] = 3
        return [
            Subscribe(CLOUD, self.cloud.activator_command_filters(), live_only=True),
            Subscribe(CLOUD, self.cloud.activator_filters(signed=self._seal is not None)),
            Subscribe(CLOUD, (self.cloud.clock,)),
        ]

    def on_disconnected(self, link: str, now_ms: int) -> list[Effect]:
        self.connected[link] = False
        if link == CLOUD:
            self.born = False
            self._rival = self._challenge_until_ms = None
            self.sensors.on_cloud_down()
            return []
        self.relay.fog_connected = False
        gone = self.drones.forget_connections()
        return [self.drones.record_of(number) for number in gone] if self.born else []

    def on_subscribed(self, subscribe: Subscribe, now_ms: int) -> list[Effect]:
        link = subscribe.link
        self._subacks[link] -= 1
        if self._subacks[link] != 0:
            return []
        if link == FOG:
            self.relay.fog_connected = True
            return []
        # The broker sends what it retains before this beacon comes back: then it is known who else is there.
        return [self._beacon(now_ms)]

    def on_message(self, link: str, message: Inbound, now_ms: int) -> list[Effect]:
        """A message from one of the two brokers; what does not follow the specification is counted."""
        try:
            if link == CLOUD:
                return self._on_cloud(self.cloud.parse(message.topic), message, now_ms)
            return self._on_fog(self.fog_side.parse(message.topic), message, now_ms)
        except PayloadError as error:
            return [Log(error.kind, f"{message.topic}: {error}")]

    def on_published(self, link: str, ref: Any, code: int, now_ms: int) -> list[Effect]:
        if isinstance(ref, Carried):
            return self.sensors.on_published(ref, code, now_ms)
        return self.relay.on_published(ref, code, now_ms) if link == FOG else []

    def tick(self, now_ms: int) -> list[Effect]:
        """Everything that is due by time; to be called at least ten times a second."""
        out = self.drones.controlled_anew(self.leases.tick(now_ms), now_ms)
        out += self._watched(self.drones.tick(now_ms), now_ms) + self.relay.tick(now_ms)
        self.selector.tick(now_ms)
        out += self.states.tick(now_ms) + self.sensors.tick(now_ms)
        if self._challenge_until_ms is not None and now_ms >= self._challenge_until_ms:
            self._rival = self._challenge_until_ms = None
            out += self._be_born(now_ms)
        if self._rebirth.is_due(now_ms) and self.born:
            out.append(self._publish_presence(up=True))
        if self.born and self.drones.roster_changed:
            out.append(self._publish_presence(up=True))
        if self.born and now_ms >= self._next_beacon_ms:
            out.append(self._beacon(now_ms))
        return out

    def goodbye(self, now_ms: int) -> list[Effect]:
        """A clean stop says that neither the fog nor its drones are reachable."""
        if not self.born:
            return []
        self.born = False
        gone = self.drones.forget_connections()
        return [*(self.drones.record_of(number) for number in gone), self._publish_presence(up=False)]

    def _on_cloud(self, topic: DroneTopic | FogTopic | StationTopic, message: Inbound, now_ms: int) -> list[Effect]:
        is_doubtful = not self.born and (self._rival is not None or not self._was_born)
        if is_doubtful and isinstance(topic, DroneTopic | FogTopic) and topic.kind in _ASKING:
            return [Log("not_born", f"{message.topic}: left to the activator that may own fog {self.fog}")]
        if isinstance(topic, StationTopic):
            return self._on_station(topic.name, message, now_ms)
        if isinstance(topic, DroneTopic):
            if topic.kind == "commands":
                return self.relay.on_command(topic.drone, message, now_ms)
            if topic.kind == "control" and self._seal is not None:
                return self._on_grant(self._seal, topic.drone, message)
            return self._on_own_record(topic.drone, message, now_ms)
        if topic.kind == "commands":
            return self.relay.on_command(None, message, now_ms)
        if topic.kind == "select":
            return self.selector.on_select(topic.name, message, now_ms)
        if topic.kind == "init_connect":
            return self._on_registration(message, now_ms)
        if topic.kind == "clock":
            return self._on_clock(decode(BeaconMessage, self._to_cloud.opened(message, self._name)), now_ms)
        if topic.kind == "reachable":
            return self._on_own_presence(message, now_ms)
        raise PayloadError(f"topic {message.topic!r}: not for an activator", "topic")

    def _on_fog(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        if topic.kind == "reachable":
            return self._on_drone_presence(topic.drone, message, now_ms)
        if topic.kind == "clock":
            return self._on_drone_beacon(topic.drone, message, now_ms)
        link = self.drones.get(topic.drone)
        if topic.kind == "state":
            return self.states.on_state(link, topic.name, message.payload, now_ms)
        if topic.kind == "states":
            return self.states.on_bundle(link, message.payload, now_ms)
        if topic.kind == "sensor":
            return self.sensors.on_reading(topic, message.payload, now_ms) if self.born else []
        if topic.kind == "commands_result":
            if link is None:
                raise PayloadError(f"topic {message.topic!r}: a drone that was never reachable", "topic")
            if self._seal is None:
                return self.relay.on_result(link, message.payload, topic.name, now_ms)
            said_on = self._to_fog.signed_topic(message.topic)
            signed = self._seal.open(said_on, message.payload, f"drone{topic.drone}")
            return self.relay.on_result(link, signed.payload, topic.name, now_ms, signed.envelope.bare())
        raise PayloadError(f"topic {message.topic!r}: not for an activator", "topic")

    def _on_drone_presence(self, drone: int, message: Inbound, now_ms: int) -> list[Effect]:
        """A drone's birth or will; a signed birth is passed on to who is to verify what the drone says."""
        presence = decode(Presence, self._to_fog.opened(message, f"drone{drone}"))
        out = self._watched(self.drones.on_presence(drone, presence, now_ms), now_ms)
        return out + self._births.on_drone(drone, message.payload) if self._seal is not None and presence.up else out

    def _on_drone_beacon(self, drone: int, message: Inbound, now_ms: int) -> list[Effect]:
        """A drone's beacon; a signed one is passed on: who signs commands makes their deadlines of it."""
        beacon = decode(BeaconMessage, self._to_fog.opened(message, f"drone{drone}"))
        out = self._watched(self.drones.on_beacon(drone, beacon, now_ms), now_ms)
        link = self.drones.get(drone)
        if self._seal is not None and self.born and link is not None and link.session == beacon.session:
            out = [*out, Publish(CLOUD, self.cloud.drone_clock(drone), message.payload, qos=0)]
        return out

    def _watched(self, out: list[Effect], now_ms: int) -> list[Effect]:
        """What follows from drones having become reachable, or not, behind what their part did by itself."""
        appeared, self.drones.appeared = self.drones.appeared, []
        for link in appeared:
            out = out + self.relay.on_drone_reachable(link, now_ms) + self.states.relay_all([link], now_ms)
        if self.drones.roster_changed:
            self.states.qods.touched = True
        return out

    def _on_registration(self, inbound: Inbound, now_ms: int) -> list[Effect]:
        if self._registrations is None:
            message = decode(Registration, inbound.payload)
        else:
            topic = self._to_cloud.signed_topic(inbound.topic)
            message = self._registrations.read(topic, inbound.payload, self.leases, now_ms)
        is_new = (message.name, message.session) not in self.leases
        if is_new and message.lease_s > 0 and len(self.leases) >= MOST_STATIONS:
            return [Log("too_many_stations", f"{message.name}: {MOST_STATIONS} stations are registered already")]
        if self._registrations is not None and is_question(message):
            return [self._beacon(now_ms, message.nonce)]
        out = self.drones.controlled_anew(self.leases.register(message, now_ms), now_ms)
        out.append(self._beacon(now_ms, message.nonce))
        if is_new and message.lease_s > 0:
            self.states.qods.forget()
            out += self.states.relay_all(self.drones.links.values(), now_ms)
            if self._seal is not None:
                out += [*self._births.on_registered(message.name), *self.drones.ask_all(now_ms)]
        return out

    def _on_station(self, name: str, message: Inbound, now_ms: int) -> list[Effect]:
        """A station's birth or will; a will that its broker may say at any time frees nothing (R12.13)."""
        if self._seal is None:
            presence = decode(Presence, message.payload)
            if presence.up:
                return []
            return self.drones.controlled_anew(self.leases.end((name, presence.session), now_ms), now_ms)
        signed = self._seal.open(self._to_cloud.signed_topic(message.topic), message.payload, f"gs-{name}")
        presence = decode(Presence, signed.payload)
        if not presence.up or not self._owners.claim(presence.session, signed.signer):
            return []
        return self._births.on_station(name, signed.certificate, presence.session, message.payload)

    def _on_grant(self, seal: Seal, drone: int, message: Inbound) -> list[Effect]:
        """A station's word on its control of a drone: passed on as it is, while the drone is the station's."""
        topic = self.fog_side.control(drone)
        signed = seal.open_of_station(self._to_fog.signed_topic(topic), Envelope.parse(message.payload))
        grant = decode(Grant, signed.payload)
        is_own = self._owners.is_of(grant.gs_session, signed.signer)
        if not is_own or not self.leases.controls(grant.gs_session, drone):
            return [Log("foreign_session", f"{message.topic}: {signed.signer} is not in control")]
        return [Publish(FOG, topic, signed.envelope.bare().routed(None).encode(), qos=1)]

    def _on_own_record(self, drone: int, message: Inbound, now_ms: int) -> list[Effect]:
        """Another session's word about a drone of this fog is put right; before birth it says who had control."""
        try:
            record = decode(DroneRecord, self._to_cloud.opened(message, self._name))
        except PayloadError as error:
            if self._seal is None or not self.born:
                raise
            return [Log(error.kind, f"{message.topic}: {error}"), self.drones.record_of(drone)]
        if not self.born:
            self.drones.restore(drone, record, now_ms)
            if record.holder is not None and record.holder_session is not None:
                self._owners.restore(record.holder_session, f"gs-{record.holder}")
            return []
        if self.drones.is_own_record(drone, record):
            return []
        if record.activator_session == self.session:
            return []  # an own record that a newer one, already under way, replaces
        return [self.drones.record_of(drone)]

    def _on_own_presence(self, message: Inbound, now_ms: int) -> list[Effect]:
        try:
            presence = decode(FogPresence, self._to_cloud.opened(message, self._name))
        except PayloadError:
            if self._seal is not None and self.born:
                self._rebirth.arm(now_ms)
            raise
        if presence.session == self.session:
            if not presence.up and self.born:
                self._rebirth.arm(now_ms)
            return []
        if self.born:
            self._rebirth.arm(now_ms)
        elif presence.up:
            self._rival = presence.session
        elif presence.session == self._rival:
            self._rival = None
        return []

    def _on_clock(self, beacon: BeaconMessage, now_ms: int) -> list[Effect]:
        """Before birth: the own beacon closes what the broker retains, a rival's proves it alive."""
        if self.born:
            return []
        is_answer = self._seal is None or beacon.nonce == self._challenge_nonce
        if beacon.session == self._rival and is_answer:
            return [Stop(f"refused: another live activator is fog {self.fog} already")]
        if beacon.session != self.session or self._challenge_until_ms is not None:
            return []
        if self._rival is None:
            return self._be_born(now_ms)
        self._challenge_until_ms = now_ms + CHALLENGE_MS
        self._challenge_nonce = secrets.randbelow(2**32)
        question = Registration(name="activator", session=self.session, nonce=self._challenge_nonce, lease_s=0)
        return [self._to_cloud.publish(self.cloud.init_connect, question, qos=1)]

    def _be_born(self, now_ms: int) -> list[Effect]:
        self.born = self._was_born = True
        return [
            Unsubscribe(CLOUD, (self.cloud.clock,)),
            self._publish_presence(up=True),
            *self.drones.records(),
            *self._births.of_drones(),
            self._beacon(now_ms),
        ]

    def _presence(self, up: bool) -> FogPresence:
        return FogPresence(
            session=self.session,
            up=up,
            broker=self._broker if up else None,
            authenticated=self._seal is not None if up else None,
            drones=self.drones.roster() if up else None,
        )

    def _publish_presence(self, up: bool) -> Publish:
        self.drones.roster_changed = False
        topic, presence = self.cloud.reachable, self._presence(up)
        return self._to_cloud.publish(topic, presence, qos=1, retain=True, with_certificate=up)

    def _beacon(self, now_ms: int, nonce: int | None = None) -> Publish:
        self._next_beacon_ms = now_ms + self.settings.beacon_interval_ms
        message = BeaconMessage(
            session=self.session, now_ms=now_ms, nonce=nonce, held_ms=0 if nonce is not None else None
        )
        return self._to_cloud.publish(self.cloud.clock, message, qos=0)
