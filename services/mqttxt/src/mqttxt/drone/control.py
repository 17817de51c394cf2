"""Who controls the drone: by the activator's lease and, where messages are signed, by the stations' grants."""

from __future__ import annotations

from ..core.channel import Channel
from ..core.effects import Inbound, Log, Stop
from ..core.session_owners import SessionOwners
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.control import DroneLease, Grant
from ..protocol.messages import Presence
from ..protocol.topics import station_reachable
from ..security.cose import Envelope
from ..security.seal import Seal, is_station
from .commands import CommandDesk
from .effects import Effect
from .grants import Grants

MOST_ACTIVATORS = 16
"""Activator sessions of which the newest lease's counter is remembered."""


class SessionControl:
    """The newest lease of one UAV client session, which it applies to the session's commands (`desk`)."""

    def __init__(self, drone: int, session: int, channel: Channel, desk: CommandDesk, owners: SessionOwners) -> None:
        self.lease: DroneLease | None = None
        self.is_refused = False
        """Whether this client was refused while its drone was armed; it stops once that is disarmed."""
        self._drone = drone
        self._session = session
        self._channel = channel
        self._desk = desk
        self._owners = owners
        self._grants = Grants()
        self._counters: dict[int, int] = {}
        """The newest lease's counter of each of the last activator sessions."""

    def take(self, lease: DroneLease) -> bool:
        """Apply a lease and return True, unless it is older than the known one."""
        if self.lease is not None and self._is_older(lease, self.lease):
            return False
        self.lease = lease
        self.is_refused = False
        self._counters.pop(lease.activator_session, None)
        self._counters[lease.activator_session] = lease.counter or 0
        if len(self._counters) > MOST_ACTIVATORS:
            del self._counters[next(iter(self._counters))]
        self._apply()
        return True

    def is_of_before(self, lease: DroneLease) -> bool:
        """Whether a lease stood in a connection while another activator session's was taken (R6.10)."""
        if self.lease is None or lease.activator_session == self.lease.activator_session or lease.counter is None:
            return False
        return lease.counter <= self._counters.get(lease.activator_session, -1)

    def on_refusal(self, lease: DroneLease, is_armed: bool) -> list[Log | Stop]:
        """Stop, as another client has the drone's number; with signed messages not while armed (R9.5)."""
        if self._channel.seal is not None and self.lease is not None:
            if self._is_repeated(lease):
                return [Log("old_lease", f"refusal {lease.counter} of drone {self._drone}: older than its lease")]
            if is_armed:
                self.is_refused = True
                return [Log("refused_in_flight", f"another UAV client is drone {self._drone}, it says; armed: goes on")]
        return [self.stop()]

    def stop(self) -> Stop:
        return Stop(f"refused: another live UAV client is drone {self._drone} already")

    def _is_repeated(self, refusal: DroneLease) -> bool:
        """Whether a refusal is older than the newest lease, if both are from the same activator session."""
        known = self.lease
        if known is None or known.activator_session != refusal.activator_session:
            return False
        return (refusal.counter or 0) <= (known.counter or 0)

    def _is_older(self, lease: DroneLease, known: DroneLease) -> bool:
        """Whether `lease` is older: by its counter in one activator session, by a signed `heard_ms` across sessions.

        Unsigned leases without a counter, from older activators, are ordered by their epoch alone.
        """
        is_of_same = lease.activator_session == known.activator_session
        if is_of_same and lease.counter is not None:
            return lease.counter <= (known.counter or 0)
        if self._channel.seal is None:
            return is_of_same and lease.epoch < known.epoch
        if is_of_same:
            return True
        return known.heard_ms is not None and (lease.heard_ms or 0) <= known.heard_ms

    def on_station(self, seal: Seal, message: Inbound) -> list[Effect]:
        """A ground station's signed birth, from which the drone learns its certificate and its session."""
        signed = seal.verified(
            Envelope.parse(message.payload), lambda station: station_reachable(station.node.label), is_station
        )
        presence = decode(Presence, signed.payload)
        if not self._owners.claim(presence.session, signed.signer):
            return [Log("foreign_session", f"{signed.signer}: session {presence.session:08x} is another station's")]
        return []

    def on_grant(self, seal: Seal, message: Inbound) -> list[Effect]:
        """A station's signed grant, beyond which no activator can extend control. Raises PayloadError."""
        signed = seal.open_of_station(self._channel.signed_topic(message.topic), Envelope.parse(message.payload))
        grant = decode(Grant, signed.payload)
        is_own = self._owners.is_of(grant.gs_session, signed.signer)
        if not is_own or not signed.certificate.rights.may_command(self._drone):
            raise PayloadError(f"grant of {signed.signer}: expected its own session and the right", "foreign_session")
        if grant.drone_session == self._session:
            self._grants.take(signed.signer, grant)
            self._apply()
        return []

    def _apply(self) -> None:
        """Apply the lease. With signed messages its ends are bounded by the grant, except for commands (R12.14)."""
        lease = self.lease
        if lease is None:
            return
        until_ms, offboard_ms, holder_session = lease.deadline_ms, lease.offboard_until_ms, lease.holder_session
        if self._channel.seal is not None:
            station = f"gs-{lease.holder}" if lease.holder is not None else None
            if station is None:
                holder_session = None
            elif holder_session is not None:
                self._owners.restore(holder_session, station)
            until_ms, offboard_ms = self._grants.bound(station, holder_session, until_ms, offboard_ms)
        self._desk.executor.lease.until_ms = until_ms
        self._desk.executor.lease.offboard_until_ms = offboard_ms
        self._desk.on_lease(holder_session, lease.epoch, lease.activator_session, lease.deadline_ms)
