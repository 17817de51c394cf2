"""One fog as a ground station sees it: registration, clock, drones and their states."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from ..core.channel import Channel
from ..core.clock import Beacon, RemoteClock, stamp_supersedes
from ..core.effects import Inbound, Publish
from ..core.settings import RESEND_FIRST_MS, Retry
from ..protocol.bundles import FogBundle, states_of
from ..protocol.codec import decode, encode
from ..protocol.control import Control, DroneRecord, Grant, Registration
from ..protocol.messages import BeaconMessage, FogPresence
from ..protocol.rankings import QodsMessage, Ranked
from ..protocol.state_payload import decode_state
from ..protocol.topics import CloudSide, DroneTopic, FogSide, FogTopic
from .drone_view import DroneView, HeardState
from .outcomes import ControlChanged, Event, QodsRanking, Reachability, StateUpdate

LINK = "cloud"
OFFBOARD_RENEWAL_MS = 1000
"""How often a station with an open offboard command registers again (R6.11) and signs grants."""
LEASE_S = 30
"""The length of a station's lease at a fog (R6.1)."""
RENEWAL_MS = LEASE_S * 1000 // 3
OFFBOARD_GRANT_MS = 3000
"""How long an offboard command may go on after its station's newest grant."""
BEACONS_MS = 2000
"""How long a confirmed registration waits for the drones' records and, where they are signed, their beacons."""
NOT_SHOWN_MS = 1000
"""How long after the SUBACK a station waits for the activator's birth before it asks for it (R6.13)."""


@dataclass(frozen=True)
class Asked:
    """A registration that may be echoed: when it was sent, its number at the fog, and whether it only asks."""

    at_ms: int
    number: int
    is_question: bool


class FogView:
    """One fog as a ground station sees it. All times are of the station's session clock."""

    def __init__(self, topics: CloudSide, name: str, session: int, channel: Channel, control: Control) -> None:
        self.topics = topics
        self.control = control
        self.claimed: set[int] = set()
        """The drones of which this station wants control, where it does not want all."""
        self.ranking: tuple[Ranked, ...] = ()
        self.in_offboard = False
        self.number = topics.fog
        self.name = f"fog{topics.fog}"
        self.session: int | None = None
        self.up = False
        self.is_signed: bool | None = None
        """Whether the activator's birth has the form of a signed message; None before one has arrived."""
        self.registered = False
        self.subscribed = False
        self.clock: RemoteClock | None = None
        self.configured: tuple[int, ...] = ()
        self.drones: dict[int, DroneView] = {}
        self._name = name
        self._own_session = session
        self.channel = channel
        self._settings = channel.settings
        self._nonces: dict[int, Asked] = {}
        self._counter = 0
        self._given_up: dict[int, int] = {}
        """Released drones, each with the number of the registration that released it, until a later one is answered."""
        self._confirmed_ms = 0
        self._next_registration_ms = 0
        self._registered_ms = 0
        self._ranked: tuple[int, int] | None = None
        """The stamp of the newest ranking in the activator's session, and when it arrived."""
        self._asking: Retry | None = None

    @property
    def epoch(self) -> int:
        """The newest epoch of control in the records of the fog's drones."""
        return max((view.record.epoch or 0 for view in self.drones.values() if view.record is not None), default=0)

    @property
    def present(self) -> frozenset[int]:
        """The drones of the activator's live session. The broker may retain records of others, from before."""
        told = {number for number, drone in self.drones.items() if self._is_told(drone)}
        return frozenset(told.union(self.configured))

    def _is_told(self, drone: DroneView) -> bool:
        return drone.record is not None and drone.record.activator_session == self.session

    def controls(self, number: int) -> bool:
        """Whether this station controls a drone, by a record of the activator's live session. A released drone that is
        claimed again counts only once the activator has answered the new claim.
        """
        view = self.drones.get(number)
        record = view.record if view is not None else None
        if record is None or record.activator_session != self.session or number in self._given_up:
            return False
        return record.holder_session == self._own_session

    def claim(self, number: int, wanted: bool, now_ms: int) -> list[Publish]:
        """Claim control of a drone, or release it."""
        if (number in self.claimed) == wanted:
            return []
        (self.claimed.add if wanted else self.claimed.discard)(number)
        out = [self.registration(now_ms)] if self.up and self.subscribed else []
        if not wanted:
            self._given_up[number] = self._counter
        return out

    def is_live(self, now_ms: int) -> bool:
        """Whether the activator is up and has sent a beacon within the last three intervals (R9.2)."""
        return self.up and self.clock is not None and self.clock.is_live(now_ms, self._settings.beacon_interval_ms)

    def on_subscribed(self, now_ms: int) -> list[Publish]:
        """The broker granted the fog's topics: register, or wait for the activator's birth, which `tick` asks for."""
        self.subscribed = True
        self._asking = Retry(now_ms + NOT_SHOWN_MS)
        return [self.registration(now_ms)] if self.up else []

    def on_presence(self, presence: FogPresence, now_ms: int) -> tuple[list[Publish], list[Event]]:
        """`fogX/reachable`: register at an activator that came up or has a new session."""
        if not presence.up:
            if presence.session != self.session or not self.up:
                return [], []
            self.up = self.registered = False
            return [], self._review(now_ms)
        anew = not self.up or presence.session != self.session
        if presence.session != self.session:
            self.session = presence.session
            self.clock = RemoteClock(presence.session)
            self.registered = False
            self._ranked = None
            self._nonces.clear()
        self.up = True
        self.configured = tuple(entry.drone for entry in presence.drones or ())
        out = [self.registration(now_ms)] if anew and self.subscribed else []
        return out, self._review(now_ms)

    def on_beacon(self, message: BeaconMessage, now_ms: int) -> tuple[list[Event], bool]:
        """`fogX/clock`. The flag is true where this beacon is the first to confirm the registration."""
        if self.clock is None or message.session != self.session:
            return [], False
        asked = self._nonces.get(message.nonce) if message.nonce is not None else None
        asked_ms = asked.at_ms if asked is not None else None
        if asked_ms is not None and message.nonce is not None and self.channel.seal is not None:
            del self._nonces[message.nonce]  # a nonce counts once: a replayed beacon confirms nothing
        beacon = Beacon(message.session, message.now_ms, message.nonce, message.held_ms)
        self.clock.observe(beacon, now_ms, asked_ms)
        if asked is not None:
            self._given_up = {drone: said for drone, said in self._given_up.items() if said >= asked.number}
        if asked is not None and asked.is_question:
            self._next_registration_ms = now_ms  # a signed registration needs the clock, which is known now
            return self._review(now_ms), False
        confirmed = asked_ms is not None and not self.registered
        if confirmed:
            self._confirmed_ms = now_ms
            self._next_registration_ms = self._registered_ms + RENEWAL_MS
        self.registered = self.registered or asked_ms is not None
        return self._review(now_ms), confirmed

    def on_drone_beacon(self, number: int, message: BeaconMessage, now_ms: int) -> list[Event]:
        """`fogX/droneY/clock`: a beacon as the drone signed it."""
        drone = self.drones.setdefault(number, DroneView(number))
        if drone.clock is None or drone.clock.session != message.session:
            drone.clock = RemoteClock(message.session)
            drone.next_grant_ms = now_ms
        drone.clock.observe(Beacon(message.session, message.now_ms), now_ms)
        return self._review(now_ms)

    def on_record(self, number: int, record: DroneRecord, now_ms: int) -> list[Event]:
        """`fogX/droneY/reachable`."""
        drone = self.drones.setdefault(number, DroneView(number))
        before = (drone.record.holder, drone.record.holder_session) if drone.record is not None else (None, None)
        if record.up and (drone.record is None or drone.record.drone_session != record.drone_session):
            drone.states.clear()
        drone.record = record
        if record.holder_session != self._own_session:
            self._given_up.pop(number, None)
        drone.session = record.drone_session or drone.session
        events = self._review(now_ms)
        if (record.holder, record.holder_session) != before:  # a station that starts anew may have its name again
            drone.holder = record.holder
            drone.next_grant_ms = now_ms
            mine = record.holder_session == self._own_session
            events.append(ControlChanged(self.number, number, record.holder, mine, record.epoch or 0))
        return events

    def on_qods(self, message: QodsMessage, now_ms: int) -> list[Event]:
        """`fogX/QoDS`: take the ranking, unless it is older than the known one."""
        if message.session != self.session:
            return []
        known = self._ranked
        if known is not None and not stamp_supersedes(message.stamp, known[0], now_ms - known[1]):
            return []
        self.ranking, self._ranked = message.ranking, (message.stamp, now_ms)
        return [QodsRanking(self.number, message.ranking)]

    def on_states(self, topic: DroneTopic | FogTopic, message: Inbound, now_ms: int) -> list[Event]:
        """`fogX/droneY/state/Z`, or a bundle on `fogX/states`: take newer states; raises PayloadError."""
        payload = self.channel.opened_state(message, self.name, self.clock, now_ms)
        if isinstance(topic, DroneTopic):
            heard = [(topic.drone, decode_state(topic.name, payload, relayed=True))]
        else:
            heard = states_of(decode(FogBundle, payload))
        out: list[Event] = []
        for number, said in heard:
            drone = self.drones.setdefault(number, DroneView(number))
            known = drone.states.get(said.state.name)
            if known is not None and not stamp_supersedes(said.stamp, known.message.stamp, now_ms - known.received_ms):
                continue
            drone.states[said.state.name] = heard_state = HeardState(said, now_ms, self.clock)
            out.append(StateUpdate(self.number, number, said.state, said.stamp, heard_state.age_ms(now_ms)))
        return out

    def tick(self, now_ms: int) -> tuple[list[Publish], list[Event]]:
        """Renew registration and grants at a third of the lease; report the drones of a fog whose beacons stopped."""
        out = []
        if self.in_offboard:
            self._next_registration_ms = min(self._next_registration_ms, self._registered_ms + OFFBOARD_RENEWAL_MS)
        if self.up and self.subscribed and now_ms >= self._next_registration_ms:
            out.append(self.registration(now_ms))
        if self.subscribed and not self.up and self._asking is not None and self._asking.is_due(now_ms):
            out.append(self.registration(now_ms, lease_s=0))
        if self.channel.seal is not None and self.registered:
            out += [
                self._grant(drone, drone.clock, now_ms)
                for drone in self.drones.values()
                if drone.clock is not None and now_ms >= self._grant_due_ms(drone) and self.controls(drone.number)
            ]
        return out, self._review(now_ms)

    def _grant_due_ms(self, drone: DroneView) -> int:
        granted_ms = drone.next_grant_ms - RENEWAL_MS
        return min(drone.next_grant_ms, granted_ms + OFFBOARD_RENEWAL_MS) if self.in_offboard else drone.next_grant_ms

    def _grant(self, drone: DroneView, clock: RemoteClock, now_ms: int) -> Publish:
        """A signed grant, by which the drone itself judges this station's control. The clock has had a beacon."""
        drone.next_grant_ms = now_ms + RENEWAL_MS
        until_ms, offboard_ms = (
            clock.deadline_ms(now_ms, ttl_ms) or 0 for ttl_ms in (LEASE_S * 1000, OFFBOARD_GRANT_MS)
        )
        grant = Grant(
            gs_session=self._own_session,
            drone_session=clock.session,
            until_ms=max(0, until_ms),
            offboard_until_ms=max(0, offboard_ms) if self.in_offboard else None,
        )
        assert self.channel.seal is not None
        signed = self.channel.seal.sign(FogSide().control(drone.number), encode(grant, self._settings.encoding))
        return Publish(LINK, self.topics.drone_control(drone.number), signed.encode(), qos=1)

    def registration(
        self, now_ms: int, lease_s: int | None = None, take: bool = False, drones: tuple[int, ...] | None = None
    ) -> Publish:
        """Make a registration: to begin or renew the lease, to end it (`lease_s` 0), or to `take` what others hold.

        Before the activator's birth has arrived, a `lease_s` of 0 asks for that birth.
        """
        nonce = secrets.randbelow(2**32)
        self._counter += 1
        self._registered_ms = now_ms
        is_signed = self.channel.seal is not None
        self._next_registration_ms = now_ms + (RENEWAL_MS if self.registered else RESEND_FIRST_MS)
        until_ms = self.clock.deadline_ms(now_ms, LEASE_S * 1000) if self.clock is not None else None
        if is_signed and until_ms is None:
            lease_s = 0
        self._nonces[nonce] = Asked(now_ms, self._counter, is_question=lease_s == 0 and not self.registered)
        while len(self._nonces) > 8:
            del self._nonces[next(iter(self._nonces))]
        control = self.control
        if control is Control.NONE and self.claimed and not take:
            control, drones = Control.WANT, drones or tuple(sorted(self.claimed))
        message = Registration(
            name=self._name,
            session=self._own_session,
            nonce=nonce,
            lease_s=LEASE_S if lease_s is None else lease_s,
            control=Control.TAKE if take else control,
            bundles=self._settings.bundles,
            drones=drones,
            until_ms=max(0, until_ms) if until_ms is not None else None,
            epoch=self.epoch if take else None,
            activator_session=self.session if self.up and (is_signed or not self.registered) else None,
            counter=self._counter if is_signed else None,
            anew=None if self.registered else True,
        )
        return self.channel.publish(
            self.topics.init_connect, message, qos=1, with_certificate=is_signed and not self.registered
        )

    def is_ready(self, now_ms: int) -> bool:
        """Whether the registration is confirmed, and the records (and signed beacons) have arrived or had time to."""
        if not self.registered:
            return False
        drones = [drone for drone in self.drones.values() if drone.record is not None and drone.record.up]
        has_records = all(number in self.drones and self._is_told(self.drones[number]) for number in self.configured)
        return (has_records and all(map(self._can_address, drones))) or now_ms >= self._confirmed_ms + BEACONS_MS

    def _can_address(self, drone: DroneView) -> bool:
        """Whether a command can be addressed to a drone: a signed one names the drone's session."""
        return self.channel.seal is None or drone.signing_clock is not None

    def _review(self, now_ms: int) -> list[Event]:
        """Update which drones are reachable; returns an event for each that changed."""
        out: list[Event] = []
        live = self.is_live(now_ms)
        for drone in self.drones.values():
            record = drone.record
            reachable = live and record is not None and record.up and record.activator_session == self.session
            reachable = reachable and self._can_address(drone)
            if reachable != drone.reachable:
                drone.reachable = reachable
                out.append(Reachability(self.number, drone.number, reachable))
        return out
