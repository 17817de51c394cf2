"""The ground stations of a fog: their registrations and births, their grants, and their words on readings."""

from __future__ import annotations

from ..core.effects import Effect, Inbound, Log, Publish
from ..core.floods import STATION_AT_ONCE, STATION_PER_S, Repetitions, TokenBucket
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.control import Grant, Registration
from ..protocol.messages import Presence
from ..protocol.readings import ReadingAck
from ..protocol.topics import DroneTopic, FogTopic, StationTopic
from ..security.cose import Envelope
from ..security.seal import Seal
from .births import Births
from .drones import FOG, Drones
from .ownership import CHALLENGER, Ownership
from .part import Part, Site
from .registrations import SignedRegistrations, is_question
from .sensor_relay import SensorRelay
from .state_relay import StateRelay

MOST_STATIONS = 1000
"""How many stations may be registered at a time; a further one is not answered."""
BIRTH, RECORDS, BEACONS = "birth", "records", "beacons"
"""Answers to registrations that serve all stations: to one with `anew` (R6.13), and the drones' beacons (R12.12)."""
BIRTHS_PER_S, BIRTHS_AT_ONCE = 10, 100
"""Limits for births and wills of one station, which may have 64 sessions."""


class Stations(Part):
    """Serves the stations that register at one activator session."""

    def __init__(
        self,
        site: Site,
        drones: Drones,
        births: Births,
        ownership: Ownership,
        states: StateRelay,
        sensors: SensorRelay,
    ) -> None:
        super().__init__(site)
        self._drones = drones
        self._births = births
        self._ownership = ownership
        self._states = states
        self._sensors = sensors
        self._budget = TokenBucket(STATION_PER_S, STATION_AT_ONCE)
        self._heard_budget = TokenBucket(STATION_PER_S, STATION_AT_ONCE)
        """Words on readings have one of their own: there may be so many that registrations would lapse beside them."""
        self._births_budget = TokenBucket(BIRTHS_PER_S, BIRTHS_AT_ONCE)
        self._welcomes: Repetitions[str] = Repetitions()
        self._shown: Repetitions[str] = Repetitions()
        seal = site.to_cloud.seal
        self._signed = SignedRegistrations(site.session, seal, site.owners) if seal is not None else None

    def on_registration(self, topic: FogTopic, inbound: Inbound, now_ms: int) -> list[Effect]:
        """`fogX/init_connect`: answered with a beacon, a registration with `anew` also with the drones' records."""
        if self._signed is None:
            message = decode(Registration, inbound.payload)
        else:
            signed_topic = self._to_cloud.signed_topic(inbound.topic)
            message = self._signed.read(signed_topic, inbound.payload, self._leases, now_ms)
        if not self._budget.takes(message.name, now_ms):
            return [Log("flood", f"registration of {message.name}: too many")]
        if message.name == CHALLENGER and message.lease_s == 0:
            self._ownership.on_challenge(message.session)
        if message.anew and message.activator_session != self._session:
            return self._show(BIRTH, now_ms)
        is_new = (message.name, message.session) not in self._leases
        if is_new and message.lease_s > 0 and len(self._leases) >= MOST_STATIONS:
            return [Log("too_many_stations", f"{message.name}: {MOST_STATIONS} stations are registered already")]
        if self._signed is not None and is_question(message):
            return [self._ownership.beacon(now_ms, message.nonce)]
        out = self._drones.controlled_anew(self._leases.register(message, now_ms), now_ms)
        if message.anew and message.lease_s > 0:
            out += self._show(RECORDS, now_ms)
        out.append(self._ownership.beacon(now_ms, message.nonce))
        if (is_new or message.anew) and message.lease_s > 0:
            is_welcome = self._welcomes.may_answer(message.name, now_ms)
            out += self._births.on_registered((message.name, message.session), anyway=is_welcome)
            out += self._welcome(now_ms) if is_welcome else []
        return out

    def tick(self, now_ms: int) -> list[Effect]:
        """Publish the postponed answers to stations that registered repeatedly."""
        out = [effect for what in self._shown.due(now_ms) for effect in self._answer(what, now_ms)]
        return out + self._welcome(now_ms) if self._welcomes.due(now_ms) else out

    def _show(self, what: str, now_ms: int) -> list[Effect]:
        """Publish what the broker may not show, or ask for it; once per second serves all stations."""
        return self._answer(what, now_ms) if self._shown.may_answer(what, now_ms) else []

    def _answer(self, what: str, now_ms: int) -> list[Effect]:
        if what == BIRTH:
            return self._ownership.introduction()
        if what == BEACONS:
            return self._drones.ask_all(now_ms)
        return [*(self._births.of_drones() if self._signed is not None else ()), *self._drones.records()]

    def _welcome(self, now_ms: int) -> list[Effect]:
        """Publish states and ranking for a new station; if messages are signed, ask the drones for beacons."""
        self._states.qods.forget()
        out = self._states.relay_all(self._drones.links.values(), now_ms)
        return out + self._show(BEACONS, now_ms) if self._signed is not None else out

    def on_presence(self, topic: StationTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A station's birth or will; where messages are signed a will frees nothing: a broker may forge it (R12.13)."""
        name, seal = topic.name, self._to_cloud.seal
        if seal is None:
            presence = decode(Presence, message.payload)
            if presence.up:
                return []
            return self._drones.controlled_anew(self._leases.end((name, presence.session), now_ms), now_ms)
        if not self._births_budget.takes(name, now_ms):  # the topic names the station
            return [Log("flood", f"birth of gs-{name}: too many")]
        signed = seal.open(self._to_cloud.signed_topic(message.topic), message.payload, f"gs-{name}")
        presence = decode(Presence, signed.payload)
        if not presence.up or not self._owners.claim(presence.session, signed.signer):
            return []
        return self._births.on_station(name, signed.certificate, presence.session, message.payload)

    def on_grant(self, seal: Seal, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A station's grant for a drone: passed on unchanged while the station controls the drone."""
        to = self._fog.control(topic.drone)
        signed = seal.open_of_station(self._to_fog.signed_topic(to), Envelope.parse(message.payload))
        grant = decode(Grant, signed.payload)
        is_own = self._owners.is_of(grant.gs_session, signed.signer)
        if not is_own or not self._leases.controls(grant.gs_session, topic.drone):
            return [Log("foreign_session", f"{message.topic}: {signed.signer} is not in control")]
        if not self._budget.takes(signed.certificate.node.label, now_ms):
            return [Log("flood", f"grant of {signed.signer}: too many")]
        return [Publish(FOG, to, signed.envelope.bare().routed(None).encode(), qos=1)]

    def on_heard(self, seal: Seal, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A station's acknowledgement of readings: passed on unchanged."""
        signed_topic = self._to_fog.signed_topic(self._fog.sensor_ack(topic.drone))
        signed = seal.open_of_station(signed_topic, Envelope.parse(message.payload)).before_its_end()
        if not any(f"gs-{name}" == signed.signer for name, _ in self._leases):
            raise PayloadError(f"{signed.signer}: expected a station that is registered", "not_registered")
        if not self._heard_budget.takes(signed.certificate.node.label, now_ms):
            return [Log("flood", f"readings that {signed.signer} has heard: too many")]
        ack = decode(ReadingAck, signed.payload)
        return self._sensors.on_heard(topic.drone, ack, signed.envelope.bare().routed(None))

    def end_revoked(self, seal: Seal, now_ms: int) -> list[Effect]:
        """After a change of the revocation list, end the registrations of revoked stations."""
        revoked = [key for key in self._leases if not seal.knows(f"gs-{key[0]}")]
        changed = [drone for key in revoked for drone in self._leases.end(key, now_ms)]
        return self._drones.controlled_anew(set(changed), now_ms)
