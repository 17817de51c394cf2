"""The drones of one fog as its activator knows them: identity, presence, clocks and last states."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field

from ..clock import Beacon, RemoteClock, stamp, stamp_supersedes
from ..messages import BeaconMessage, DroneLease, DroneRecord, Presence, RosterEntry
from ..topics import CloudSide, FogSide
from ..wire.codec import encode
from ..wire.states import StampedState, decode_state, encode_state
from .effects import Effect, Log, Publish
from .settings import Settings

FOG = "fog"
CLOUD = "cloud"
CONTEST_MS = 1500
"""How long the bound session of a number has to answer when a second one appears."""
STATE_KEPT_MS = 600_000
"""A stamp's span is 655 s: older states are not told any more."""


@dataclass
class Known:
    """A state as it came, and when: what its relay stamp will be follows from the drone's clock."""

    state: StampedState
    received_ms: int
    relay_stamp: int | None = None


@dataclass
class DroneLink:
    """One drone: the session bound to its number, and what is known of it."""

    number: int
    session: int | None = None
    up: bool = False
    announced: bool = False
    clock: RemoteClock | None = None
    states: dict[str, Known] = field(default_factory=dict)
    nonces: dict[int, int] = field(default_factory=dict)
    challenger: int | None = None
    contest_until_ms: int = 0
    next_lease_ms: int = 0

    def is_live(self, now_ms: int, interval_ms: int) -> bool:
        return self.up and self.clock is not None and self.clock.is_live(now_ms, interval_ms)


class Drones:
    """Every drone configured for the fog or seen in this session."""

    def __init__(
        self, session: int, settings: Settings, cloud: CloudSide, fog: FogSide, configured: tuple[int, ...]
    ) -> None:
        self._session = session
        self._settings = settings
        self._cloud = cloud
        self._fog = fog
        self.links: dict[int, DroneLink] = {number: DroneLink(number) for number in configured}

    def get(self, number: int) -> DroneLink | None:
        return self.links.get(number)

    def roster(self) -> tuple[RosterEntry, ...]:
        return tuple(
            RosterEntry(drone=link.number, session=link.session if link.announced else None)
            for link in sorted(self.links.values(), key=lambda link: link.number)
        )

    def forget_connections(self) -> list[int]:
        """The fog broker is gone: no drone is reachable until it says so again. Returns those that were."""
        gone = [link.number for link in self.links.values() if link.announced]
        for link in self.links.values():
            link.up = link.announced = False
        return gone

    def on_presence(self, number: int, presence: Presence, now_ms: int) -> list[Effect]:
        """`droneY/reachable`: bind, contest, or mark as gone."""
        link = self.links.setdefault(number, DroneLink(number))
        if not presence.up:
            if presence.session == link.session and link.up:
                link.up = False
                return self._announce(link, False)
            return []
        if presence.session == link.session:
            link.up = True
            return [self._lease(link, now_ms)]
        if link.is_live(now_ms, self._settings.beacon_interval_ms):
            return self._contest(link, presence.session, now_ms)
        return self._bind(link, presence.session, now_ms)

    def on_beacon(self, number: int, message: BeaconMessage, now_ms: int) -> list[Effect]:
        """`droneY/clock`: what the bound session's clock reads; the first echo makes the drone reachable."""
        link = self.links.get(number)
        if link is None or message.session != link.session or link.clock is None:
            return [Log("unknown_session", f"beacon of drone {number} from session {message.session:08x}")]
        asked_ms = link.nonces.get(message.nonce) if message.nonce is not None else None
        link.clock.observe(Beacon(message.session, message.now_ms, message.nonce, message.held_ms), now_ms, asked_ms)
        out: list[Effect] = []
        if link.challenger is not None and asked_ms is not None:
            out.append(self._refuse(link, link.challenger))
            link.challenger = None
        if link.up and not link.announced and link.clock.latest_now_ms(now_ms) is not None:
            out += self._announce(link, True)
        return out

    def on_state(self, number: int, name: str, payload: bytes, now_ms: int) -> str | None:
        """`droneY/state/Z`: keep it if it is newer than what is known; returns its name then."""
        link = self.links.get(number)
        state = decode_state(name, payload, relayed=False)
        if link is None or link.clock is None:
            return None
        known = link.states.get(name)
        if known is not None and not stamp_supersedes(state.stamp, known.state.stamp, now_ms - known.received_ms):
            return None
        link.states[name] = Known(state, now_ms)
        return name

    def relay_state(self, link: DroneLink, name: str, now_ms: int) -> list[Effect]:
        """The state for the ground stations, with a conservative stamp in front; nothing before an echo."""
        known = link.states.get(name)
        if known is None or link.clock is None or now_ms - known.received_ms > STATE_KEPT_MS:
            return []
        if known.relay_stamp is None:
            age_ms = link.clock.age_ms(known.state.stamp, known.received_ms)
            if age_ms is None:
                return []
            known.relay_stamp = stamp(known.received_ms - age_ms)
        relayed = StampedState(known.state.state, known.state.stamp, known.relay_stamp)
        payload = encode_state(relayed, self._settings.encoding)
        return [Publish(CLOUD, self._cloud.drone_state(link.number, name), payload, qos=0)]

    def relay_all_states(self, now_ms: int) -> list[Effect]:
        """What a station that has just registered needs to know."""
        return [
            effect
            for link in self.links.values()
            if link.announced
            for name in link.states
            for effect in self.relay_state(link, name, now_ms)
        ]

    def records(self) -> list[Effect]:
        """Every drone's record, in this session's words."""
        return [self._record(link) for link in self.links.values()]

    def record_of(self, number: int) -> Effect:
        """The record of a drone, known or not: an unknown one is not reachable."""
        return self._record(self.links.get(number) or DroneLink(number))

    def is_own_record(self, number: int, record: DroneRecord) -> bool:
        """Whether a retained record says what this session would say."""
        link = self.links.get(number)
        expected = link.session if link is not None and link.announced else None
        return record.activator_session == self._session and (record.drone_session if record.up else None) == expected

    def tick(self, now_ms: int) -> list[Effect]:
        """Leases that are due, contests that ran out, beacons that stayed away."""
        out: list[Effect] = []
        for link in self.links.values():
            if link.challenger is not None and now_ms >= link.contest_until_ms:
                challenger, link.challenger = link.challenger, None
                out += self._bind(link, challenger, now_ms)
            if link.announced and not link.is_live(now_ms, self._settings.beacon_interval_ms):
                out += self._announce(link, False)
            if link.up and now_ms >= link.next_lease_ms:
                out.append(self._lease(link, now_ms))
        return out

    def _bind(self, link: DroneLink, session: int, now_ms: int) -> list[Effect]:
        out = self._announce(link, False) if link.announced else []
        link.session = session
        link.challenger = None
        link.up = True
        link.clock = RemoteClock(session)
        link.states.clear()
        link.nonces.clear()
        return [*out, self._lease(link, now_ms)]

    def _contest(self, link: DroneLink, challenger: int, now_ms: int) -> list[Effect]:
        if link.challenger == challenger:
            return []
        link.challenger = challenger
        link.contest_until_ms = now_ms + CONTEST_MS
        return [
            Log(
                "contested",
                f"drone {link.number}: session {challenger:08x} while {link.session:08x} is bound",
            ),
            self._lease(link, now_ms),
        ]

    def _announce(self, link: DroneLink, reachable: bool) -> list[Effect]:
        link.announced = reachable
        return [self._record(link)]

    def _record(self, link: DroneLink) -> Publish:
        record = DroneRecord(
            activator_session=self._session,
            up=link.announced,
            drone_session=link.session if link.announced else None,
        )
        payload = encode(record, self._settings.encoding)
        return Publish(CLOUD, self._cloud.drone_reachable(link.number), payload, qos=1, retain=True)

    def _lease(self, link: DroneLink, now_ms: int) -> Publish:
        assert link.session is not None
        nonce = secrets.randbelow(2**32)
        link.nonces[nonce] = now_ms
        while len(link.nonces) > 8:
            del link.nonces[next(iter(link.nonces))]
        link.next_lease_ms = now_ms + self._settings.beacon_interval_ms
        return self._publish_lease(link.number, link.session, nonce, bound=True)

    def _refuse(self, link: DroneLink, session: int) -> Publish:
        return self._publish_lease(link.number, session, secrets.randbelow(2**32), bound=False)

    def _publish_lease(self, number: int, session: int, nonce: int, bound: bool) -> Publish:
        lease = DroneLease(activator_session=self._session, drone_session=session, nonce=nonce, bound=bound)
        payload = encode(lease, self._settings.encoding)
        return Publish(FOG, self._fog.init_connect(number), payload, qos=1)
