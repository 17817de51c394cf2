"""The drones of one fog at its activator: their presence, their records for stations, and their leases."""

from __future__ import annotations

import secrets

from ..core.clock import Beacon
from ..core.effects import Effect, Log, Publish
from ..core.settings import Rebirth
from ..protocol.control import DroneLease, DroneRecord
from ..protocol.messages import BeaconMessage, Presence, RosterEntry
from .drone_link import DroneLink
from .leases import Key
from .part import Part, Site

FOG = "fog"
CLOUD = "cloud"
CONTEST_MS = 1500
"""How long the bound session has to answer when a second one appears, or when it may be gone (R9.5, R19.1)."""
OFFBOARD_LEASE_MS = 3000
"""How long an offboard flight may go on after its station's newest renewal was sent."""
OFFBOARD_RENEWAL_MS = 500


class Drones(Part):
    """Every drone configured for the fog or seen in this session.

    `appeared` has drones, and `roster_changed` a change, that the activator has not handled yet. `tells`: this session
    is the fog's activator, publishes records and hands down leases. Before that it reads the records of another
    session. That one may still lead the drones, or has led them since the cloud's broker was lost: a lease would end
    the control that it has given.
    """

    def __init__(self, site: Site, configured: tuple[int, ...]) -> None:
        super().__init__(site)
        self._settings = site.to_cloud.settings
        self.links: dict[int, DroneLink] = {number: DroneLink(number) for number in configured}
        self._of_before: set[int] = set()
        self.were_shown = False
        """Whether the broker has shown an earlier session's records by wildcard, and so has shown all of them."""
        self._shown_wrong: dict[int, Rebirth] = {}
        self.appeared: list[DroneLink] = []
        self.roster_changed = False
        self.tells = False

    def roster(self) -> tuple[RosterEntry, ...]:
        return tuple(
            RosterEntry(drone=link.number, session=link.session if link.announced else None)
            for link in sorted(self.links.values(), key=lambda link: link.number)
        )

    def asked(self) -> tuple[RosterEntry, ...]:
        """The drones to which an earlier session may have sent a command: the roster, and those in its records."""
        missing = (RosterEntry(drone=number) for number in self._of_before - self.links.keys())
        return tuple(sorted((*self.roster(), *missing), key=lambda entry: entry.drone))

    def forget_connections(self) -> list[int]:
        """The fog broker is lost: no drone is reachable until its next birth. Returns those that were reachable."""
        gone = [link.number for link in self.links.values() if link.announced]
        for link in self.links.values():
            self._miss(link)
        self.roster_changed = self.roster_changed or bool(gone)
        return gone

    def forget_path(self, path: str) -> list[Effect]:
        """One of several connections to the fog is lost: drones that are present over no other become unreachable."""
        out: list[Effect] = []
        for link in self.links.values():
            link.paths.discard(path)
            if link.up and not link.paths:
                was_announced = link.announced
                self._miss(link)
                out += self._announce(link, False) if was_announced else []
        return out

    def path_of(self, number: int) -> str | None:
        """The better connection to a drone, as it measures them."""
        link = self.links.get(number)
        return link.path if link is not None and link.path in link.paths else None

    def _miss(self, link: DroneLink) -> None:
        link.up = link.announced = False
        link.gone_at_ms = None
        link.missed = True
        link.paths.clear()
        link.nonces.clear()

    def on_presence(self, number: int, presence: Presence, now_ms: int, path: str = "") -> list[Effect]:
        """`droneY/reachable`: bind, contest, or mark as gone."""
        link = self.links.get(number)
        if link is None:
            link = self.links[number] = DroneLink(number)
            self._leases.add(number, now_ms)
            self.roster_changed = True
        if not presence.up:
            if presence.session == link.challenger:
                link.challenger_paths.discard(path)
                link.challenger = link.challenger if link.challenger_paths else None
            if presence.session == link.session and link.up:
                link.paths.discard(path)
                if link.paths or link.gone_at_ms is not None:
                    return []
                if presence.several:  # its other connection may be to the same broker
                    link.gone_at_ms = now_ms + CONTEST_MS
                    return self._lease(link, now_ms)
                return self._end(link)
            return []
        if presence.session == link.session:
            if link.announced and path not in link.paths:
                self.appeared.append(link)  # a new connection: messages over the one before may be lost
            link.up, link.gone_at_ms = True, None
            link.paths.add(path)
            return self._lease(link, now_ms)
        if link.is_live(now_ms, self._settings.beacon_interval_ms):
            return self._contest(link, presence.session, path, now_ms)
        return self._bind(link, presence.session, {path}, now_ms)

    def on_beacon(self, number: int, message: BeaconMessage, now_ms: int, path: str = "") -> list[Effect]:
        """`droneY/clock`: a beacon of the bound session; the first echo makes the drone reachable."""
        link = self.links.get(number)
        if link is None or message.session != link.session or link.clock is None:
            return [Log("unknown_session", f"beacon of drone {number} from session {message.session:08x}")]
        asked_ms = link.nonces.pop(message.nonce, None) if message.nonce is not None else None
        if asked_ms is not None:
            link.knows_certificate, link.missed = True, False
        link.clock.observe(Beacon(message.session, message.now_ms, message.nonce, message.held_ms), now_ms, asked_ms)
        if asked_ms is not None and link.gone_at_ms is not None and asked_ms >= link.gone_at_ms - CONTEST_MS:
            link.gone_at_ms = None
            link.paths.add(path)
        if message.now_ms >= (link.heard_ms or 0):
            link.path = path
        link.heard_ms = max(message.now_ms, link.heard_ms or 0)
        out: list[Effect] = []
        was_contested_ms = link.contest_until_ms - CONTEST_MS
        if link.challenger is not None and asked_ms is not None and asked_ms >= was_contested_ms:
            out.append(self._refuse(link, link.challenger))
            link.challenger = None
        is_live = link.is_live(now_ms, self._settings.beacon_interval_ms)
        if is_live and not link.announced and link.clock.latest_now_ms(now_ms) is not None:
            out += self._announce(link, True)
            if self._leases.holder(number) is not None:
                out += self._lease(link, now_ms)
        return out

    def records(self) -> list[Effect]:
        """Publish every drone's record; none before this session is the fog's activator."""
        return [self._record(link) for link in self.links.values()] if self.tells else []

    def record_of(self, number: int) -> Effect:
        """Publish the record of a drone; an unknown one is unreachable."""
        return self._record(self.links.get(number) or DroneLink(number))

    def controlled_anew(self, numbers: set[int], now_ms: int) -> list[Effect]:
        """The holders of these drones have changed: publish records and leases."""
        out: list[Effect] = []
        for link in (self.links[number] for number in sorted(numbers) if number in self.links):
            out += self._told(link)
            if link.up and link.session is not None:
                out += self._lease(link, now_ms)
        return out

    def ask_all(self, now_ms: int) -> list[Effect]:
        """Ask every present drone for a beacon, by a lease."""
        present = [link for link in self.links.values() if link.up and link.session is not None]
        return [lease for link in present for lease in self._lease(link, now_ms)]

    def on_cloud_down(self, now_ms: int) -> list[Effect]:
        """Hand down what stations have prolonged since the newest leases: no more follow until the cloud is back."""
        out: list[Effect] = []
        for link in self.links.values():
            holder = self._leases.holder(link.number)
            if holder is not None and link.up and now_ms < holder.until_ms != link.told_until_ms:
                out += self._lease(link, now_ms)
        self.tells = False
        return out

    def show_certificate(self, now_ms: int) -> list[Effect]:
        """The activator has a new certificate: leases carry it to each drone until the drone has echoed one."""
        for link in self.links.values():
            link.knows_certificate = False
            link.nonces.clear()
        return self.ask_all(now_ms)

    def restore(self, number: int, record: DroneRecord, by_name: bool, now_ms: int) -> None:
        """Take over a record that an earlier activator session retained; `by_name`: not shown by wildcard."""
        self.were_shown |= not by_name and record.activator_session != self._session
        key: Key | None = None
        if record.holder is not None and record.holder_session is not None:
            key = (record.holder, record.holder_session)
        self._of_before.add(number)
        self._leases.restore(number, key, record.epoch or 0, now_ms)

    def on_record(self, number: int, record: DroneRecord | None, now_ms: int) -> None:
        """The record that the broker shows of a drone, None if it is invalid.

        Any but this session's newest record is corrected later, whatever the broker shows meanwhile (R9.1).
        """
        if record != self._word_of(self.links.get(number) or DroneLink(number)):
            self._shown_wrong.setdefault(number, Rebirth()).arm(now_ms)

    def tick(self, now_ms: int) -> list[Effect]:
        """Correct records, send due leases, end contests, and announce drones without beacons as unreachable."""
        due = [number for number, rebirth in self._shown_wrong.items() if rebirth.is_due(now_ms)]
        for number in due:
            del self._shown_wrong[number]
        out: list[Effect] = [self.record_of(number) for number in due]
        for link in self.links.values():
            if not self.tells:  # it may not ask the bound session yet
                link.contest_until_ms = now_ms + CONTEST_MS
                link.gone_at_ms = now_ms + CONTEST_MS if link.gone_at_ms is not None else None
            if link.challenger is not None and now_ms >= link.contest_until_ms:
                challenger, link.challenger = link.challenger, None
                out += self._bind(link, challenger, link.challenger_paths, now_ms)
            if link.gone_at_ms is not None and now_ms >= link.gone_at_ms:
                out += self._end(link)
            if link.announced and not link.is_live(now_ms, self._settings.beacon_interval_ms):
                out += self._announce(link, False)
            if link.up and now_ms >= link.next_lease_ms:
                out += self._lease(link, now_ms)
        return out

    def _bind(self, link: DroneLink, session: int, paths: set[str], now_ms: int) -> list[Effect]:
        out = self._announce(link, False) if link.announced else []
        link.bind(session, paths)
        return [*out, *self._lease(link, now_ms)]

    def _contest(self, link: DroneLink, challenger: int, path: str, now_ms: int) -> list[Effect]:
        if link.challenger == challenger:
            link.challenger_paths.add(path)
            return []
        link.challenger = challenger
        link.challenger_paths = {path}
        link.contest_until_ms = now_ms + CONTEST_MS
        return [
            Log("contested", f"drone {link.number}: session {challenger:08x} while {link.session:08x} is bound"),
            *self._lease(link, now_ms),
        ]

    def _end(self, link: DroneLink) -> list[Effect]:
        link.up, link.gone_at_ms = False, None
        return self._announce(link, False)

    def _announce(self, link: DroneLink, reachable: bool) -> list[Effect]:
        link.announced = reachable
        self.roster_changed = True
        if reachable:
            self.appeared.append(link)
        return self._told(link)

    def _told(self, link: DroneLink) -> list[Effect]:
        return [self._record(link)] if self.tells else []

    def _record(self, link: DroneLink) -> Publish:
        topic = self._cloud.drone_reachable(link.number)
        return self._to_cloud.publish(topic, self._word_of(link), qos=1, retain=True)

    def _word_of(self, link: DroneLink) -> DroneRecord:
        holder = self._leases.holder(link.number)
        return DroneRecord(
            activator_session=self._session,
            up=link.announced,
            drone_session=link.session if link.announced else None,
            holder=holder.key[0] if holder is not None else None,
            holder_session=holder.key[1] if holder is not None else None,
            epoch=self._leases.epoch(link.number) or None,
        )

    def _lease(self, link: DroneLink, now_ms: int) -> list[Effect]:
        assert link.session is not None
        if not self.tells:
            link.next_lease_ms = now_ms
            return []
        nonce = secrets.randbelow(2**32)
        link.nonces[nonce] = now_ms
        while len(link.nonces) > 8:
            del link.nonces[next(iter(link.nonces))]
        holder, deadline_ms, offboard_ms = self._leases.holder(link.number), None, None
        link.told_until_ms = holder.until_ms if holder is not None else None
        interval_ms = OFFBOARD_RENEWAL_MS if link.in_offboard else self._settings.beacon_interval_ms
        if holder is not None:
            interval_ms = min(interval_ms, max(OFFBOARD_RENEWAL_MS, (holder.until_ms - now_ms) // 3))
        link.next_lease_ms = now_ms + interval_ms
        if holder is not None and link.clock is not None:
            deadline_ms = link.clock.deadline_ms(now_ms, holder.until_ms - now_ms)
            if link.in_offboard and holder.sent_ms is not None:
                offboard_ms = link.clock.deadline_ms(now_ms, holder.sent_ms + OFFBOARD_LEASE_MS - now_ms)
        has_control = holder is not None and deadline_ms is not None and deadline_ms >= 0
        lease = DroneLease(
            activator_session=self._session,
            drone_session=link.session,
            nonce=nonce,
            bound=True,
            epoch=self._leases.epoch(link.number),
            holder=holder.key[0] if holder is not None and has_control and self._to_fog.seal is not None else None,
            holder_session=holder.key[1] if holder is not None and has_control else None,
            deadline_ms=deadline_ms if has_control else None,
            offboard_until_ms=max(0, offboard_ms) if offboard_ms is not None else None,
            heard_ms=link.heard_ms if self._to_fog.seal is not None else None,
            anew=link.missed or None,
            counter=link.next_lease(),
        )
        return [self._publish_lease(link, lease)]

    def _refuse(self, link: DroneLink, session: int) -> Publish:
        refused = DroneLease(
            activator_session=self._session,
            drone_session=session,
            nonce=secrets.randbelow(2**32),
            bound=False,
            epoch=0,
            counter=link.next_lease(),
        )
        return self._publish_lease(link, refused)

    def _publish_lease(self, link: DroneLink, lease: DroneLease) -> Publish:
        is_known = link.knows_certificate and link.session == lease.drone_session
        return self._to_fog.publish(
            self._fog.init_connect(link.number), lease, qos=1, with_certificate=not is_known, everywhere=True
        )
