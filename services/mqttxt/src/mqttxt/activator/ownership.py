"""Which session is a fog's activator: its birth, its challenge to another one, and its retained messages (R9.6)."""

from __future__ import annotations

import secrets

from ..core.effects import Effect, Inbound, Publish, Stop, Subscribe, Unsubscribe, Will
from ..core.settings import RESEND_FIRST_MS, Rebirth
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.control import DroneRecord, Registration
from ..protocol.messages import BeaconMessage, FogPresence
from ..protocol.topics import DroneTopic, FogTopic
from .births import Births
from .drones import CLOUD, Drones
from .part import Part, Site

CHALLENGE_MS = 3000
"""How long another live activator of this fog has to answer before this one takes its place.

For as long after its birth this one also challenges a session that the broker had not shown before.
"""
CHALLENGER = "activator"
"""The name in a challenge, which is the question of a registration."""
MOST_CHALLENGERS = 100


class Ownership(Part):
    """One activator session's claim to its fog. `born`: it is the fog's activator, and has published its birth."""

    def __init__(self, site: Site, drones: Drones, births: Births, broker: str | None) -> None:
        super().__init__(site)
        self.born = False
        self._drones = drones
        self._births = births
        self._broker = broker
        self._first_born_ms: int | None = None
        self._born_ms = 0
        self._by_name: tuple[str, ...] = ()
        self._closes_ms: int | None = None
        """An own beacon made since then ends, on its return, the retained messages; None while a SUBACK is awaited."""
        self._next_beacon_ms = 0
        self._rival: int | None = None
        self._challenge_until_ms: int | None = None
        self._challenge_nonce = 0
        self._was_answered = self._is_last_challenge = False
        self._challengers: set[int] = set()
        """The sessions that have challenged this one on this connection."""
        self._rebirth = Rebirth()
        self._newest_birth = b""

    @property
    def is_doubtful(self) -> bool:
        """Whether the fog may be another activator's; commands and registrations are then left to that one."""
        return not self.born and (self._rival is not None or self._first_born_ms is None)

    def will(self) -> Will:
        """The will of the connection to the cloud broker."""
        return Will(self._cloud.reachable, self._to_cloud.payload(self._cloud.reachable, self._presence(up=False)))

    def on_cloud_down(self) -> None:
        self.born = False
        self._by_name = ()
        self._rival = self._challenge_until_ms = self._closes_ms = None
        self._was_answered = self._is_last_challenge = False
        self._challengers.clear()

    def tick(self, now_ms: int) -> list[Effect]:
        """End a challenge that nobody answered; publish presence and beacons that are due."""
        out: list[Effect] = []
        if self._challenge_until_ms is not None and now_ms >= self._challenge_until_ms:
            out += self._challenge_over(now_ms)
        if self._rebirth.is_due(now_ms) and self.born:
            out.append(self._publish_presence(up=True))
        if self.born and self._drones.roster_changed:
            out.append(self._publish_presence(up=True))
        is_closing = self._closes_ms is not None and self._challenge_until_ms is None
        if (self.born or is_closing) and now_ms >= self._next_beacon_ms:
            out.append(self.beacon(now_ms) if self.born else self._closing_beacon(now_ms))
        return out

    def goodbye(self) -> list[Effect]:
        """At a clean stop, publish that neither the fog nor its drones are reachable."""
        if not self.born:
            return []
        self.born = False
        gone = self._drones.forget_connections()
        return [*(self._drones.record_of(number) for number in gone), self._publish_presence(up=False)]

    def on_presence(self, topic: FogTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """`fogX/reachable`: corrected if it is not this session's birth; before the birth it shows a rival session."""
        try:
            presence = decode(FogPresence, self._to_cloud.opened(message, self._name))
        except PayloadError:
            if self._to_cloud.seal is not None and self.born:
                self._rebirth.arm(now_ms)
            raise
        if presence.session == self._session:
            is_newest = message.payload == self._newest_birth
            if self.born and not is_newest and (self._to_cloud.seal is not None or not presence.up):
                self._rebirth.arm(now_ms)
            return []
        if self.born:
            self._rebirth.arm(now_ms)
            return self._doubt(presence.session, now_ms) if presence.up else []
        if presence.up:
            self._rival = presence.session
        elif presence.session == self._rival:
            self._rival = None
        return []

    def on_clock(self, topic: FogTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """`fogX/clock`: a rival's beacon proves it alive; before the birth the own one ends the retained messages."""
        beacon = decode(BeaconMessage, self._to_cloud.opened(message, self._name))
        if beacon.session == self._rival:
            is_answer = self._challenge_until_ms is not None and beacon.nonce == self._challenge_nonce
            is_younger = not self.born or beacon.now_ms >= now_ms
            yields = self._is_last_challenge and (self._rival not in self._challengers or self._session < self._rival)
            if (is_answer and yields) or (is_younger and (is_answer or self._to_cloud.seal is None)):
                return [Stop(f"refused: another live activator is fog {self._cloud.fog} already")]
            self._was_answered = self._was_answered or is_answer
        if self.born or beacon.session != self._session or self._challenge_until_ms is not None:
            return []
        if self._closes_ms is None or beacon.now_ms < self._closes_ms:
            return []
        return self._go_on(now_ms) if self._rival is None else [self._ask(now_ms)]

    def on_challenge(self, session: int) -> None:
        """Another activator of this fog asks whether this one is there; it is answered as a station is."""
        if self.born and session != self._session and len(self._challengers) < MOST_CHALLENGERS:
            self._challengers.add(session)

    def on_subscribed(self, now_ms: int) -> list[Effect]:
        """The last subscriptions are granted: send the beacon that ends the retained messages, or challenge a rival."""
        self._closes_ms = now_ms
        return [self._ask(now_ms) if self.born else self._closing_beacon(now_ms)]

    def _closing_beacon(self, now_ms: int) -> Publish:
        """The own beacon that ends the retained messages; sent again until it returns."""
        beacon = self.beacon(now_ms)
        self._next_beacon_ms = now_ms + RESEND_FIRST_MS
        return beacon

    def on_record(self, topic: DroneTopic, message: Inbound, now_ms: int) -> list[Effect]:
        """A drone's record: corrected if it is not this session's newest; before the birth it shows who had control."""
        try:
            record = decode(DroneRecord, self._to_cloud.opened(message, self._name))
        except PayloadError:
            if self.born:
                self._drones.on_record(topic.drone, None, now_ms)
            raise
        if not self.born:
            self._drones.restore(topic.drone, record, bool(self._by_name), now_ms)
            if record.holder is not None and record.holder_session is not None:
                self._owners.restore(record.holder_session, f"gs-{record.holder}")
        else:
            self._drones.on_record(topic.drone, record, now_ms)
        return []

    def introduction(self) -> list[Effect]:
        """Publish the birth again, for a station to which the broker has not shown it."""
        return [self._publish_presence(up=True)] if self.born else []

    def on_identity(self, is_renewed: bool, now_ms: int) -> list[Effect]:
        """Publish birth and beacon with the newest revocation list's number; after a renewal also the records."""
        if not self.born:
            return []
        records = self._drones.records() if is_renewed else []
        return [self._publish_presence(up=True), *records, self.beacon(now_ms)]

    def beacon(self, now_ms: int, nonce: int | None = None) -> Publish:
        """Publish a beacon, in answer to `nonce` if there is one."""
        self._next_beacon_ms = now_ms + self._to_cloud.settings.beacon_interval_ms
        held_ms = 0 if nonce is not None else None
        message = BeaconMessage(
            session=self._session, now_ms=now_ms, nonce=nonce, held_ms=held_ms, revoked=self._to_cloud.list_number
        )
        return self._to_cloud.publish(self._cloud.clock, message, qos=0)

    def _go_on(self, now_ms: int) -> list[Effect]:
        """No other activator has the fog: publish the birth, or first subscribe to missing records by name (R6.9)."""
        if self._first_born_ms is not None or self._drones.were_shown or self._by_name or not self._drones.links:
            return self._be_born(now_ms)
        self._by_name = tuple(self._cloud.drone_reachable(number) for number in self._drones.links)
        self._closes_ms = None
        return [Subscribe(CLOUD, self._by_name)]

    def _doubt(self, rival: int, now_ms: int) -> list[Effect]:
        """Challenge another activator that claims the fog, if this one was just born: the other may be older."""
        if now_ms >= self._born_ms + CHALLENGE_MS or self._rival is not None:
            return []
        self._rival = rival
        return [Subscribe(CLOUD, (self._cloud.clock,))]

    def _challenge_over(self, now_ms: int) -> list[Effect]:
        """Nobody has made this one stop; an activator that is there all the same is challenged a last time (R9.6).

        Their ages may differ by less than an answer takes; or the other one is not new, and challenges nobody.
        """
        self._is_last_challenge = self.born and self._was_answered and not self._is_last_challenge
        self._was_answered = False
        if self._is_last_challenge:
            return [self._ask(now_ms)]
        self._rival = self._challenge_until_ms = None
        return [Unsubscribe(CLOUD, (self._cloud.clock,))] if self.born else self._go_on(now_ms)

    def _ask(self, now_ms: int) -> Publish:
        self._challenge_until_ms = now_ms + CHALLENGE_MS
        self._challenge_nonce = secrets.randbelow(2**32)
        question = Registration(name=CHALLENGER, session=self._session, nonce=self._challenge_nonce, lease_s=0)
        return self._to_cloud.publish(self._cloud.init_connect, question, qos=1)

    def _be_born(self, now_ms: int) -> list[Effect]:
        self.born = self._drones.tells = True
        self._born_ms = now_ms
        self._first_born_ms = now_ms if self._first_born_ms is None else self._first_born_ms
        return [
            Unsubscribe(CLOUD, (self._cloud.clock, *self._by_name)),
            self._publish_presence(up=True),
            *self._drones.records(),
            *self._births.of_drones(),
            self.beacon(now_ms),
        ]

    def _presence(self, up: bool) -> FogPresence:
        return FogPresence(
            session=self._session,
            up=up,
            broker=self._broker if up else None,
            authenticated=self._to_cloud.seal is not None if up else None,
            drones=self._drones.roster() if up else None,
            revoked=self._to_cloud.list_number if up else None,
        )

    def _publish_presence(self, up: bool) -> Publish:
        self._drones.roster_changed = False
        topic, presence = self._cloud.reachable, self._presence(up)
        said = self._to_cloud.publish(topic, presence, qos=1, retain=True, with_certificate=up)
        self._newest_birth = said.payload
        return said
