"""Checks signed registrations: for this session, newer than the one before, within the station's rights (R12.13)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..core.session_owners import MOST_OF_ONE, SessionOwners
from ..errors import PayloadError
from ..protocol.codec import decode
from ..protocol.control import Control, Registration
from ..security.cose import Envelope
from ..security.rights import Rights
from ..security.seal import Seal, is_station
from .leases import Key, Leases


def is_question(message: Registration) -> bool:
    """Whether a registration only asks for a beacon, without which a station cannot name the end of a lease.

    It ends no lease.
    """
    return message.lease_s == 0 and message.until_ms is None


@dataclass
class _Newest:
    counter: int
    until_ms: int


class SignedRegistrations:
    """Reads `fogX/init_connect` for one activator session (R12.13)."""

    def __init__(self, session: int, seal: Seal, owners: SessionOwners) -> None:
        self._session = session
        self._seal = seal
        self._owners = owners
        self._newest: dict[Key, _Newest] = {}

    def read(self, topic: str, payload: bytes, leases: Leases, now_ms: int) -> Registration:
        """Read a registration, reduced to its station's rights; raises PayloadError if it must be dropped.

        One with `anew` for another session is returned unchanged: it only asks for this session's birth.
        """
        own = self._seal.name
        signed = self._seal.verified(Envelope.parse(payload), lambda _: topic, lambda c: is_station(c) or c.name == own)
        message = decode(Registration, signed.payload)
        if signed.signer == own:
            return _question(message)
        if signed.certificate.node.label != message.name or not self._owners.claim(message.session, signed.signer):
            raise PayloadError(f"registration of {signed.signer}: expected its own name and session", "foreign_session")
        key = message.name, message.session
        self._newest = {known: newest for known, newest in self._newest.items() if now_ms <= newest.until_ms}
        newest = self._newest.get(key)
        if message.anew and message.activator_session != self._session:
            return message
        if message.activator_session != self._session or message.counter is None:
            raise PayloadError(
                f"registration of {signed.signer}: expected this session and a counter", "old_registration"
            )
        if newest is not None and message.counter <= newest.counter:
            raise PayloadError(f"registration of {signed.signer}: expected a newer one", "old_registration")
        if newest is None and sum(name == message.name for name, _ in self._newest) >= MOST_OF_ONE:
            raise PayloadError(f"registration of {signed.signer}: {MOST_OF_ONE} are registered", "too_many_stations")
        if message.lease_s > 0:
            if message.until_ms is None or message.until_ms <= now_ms:
                raise PayloadError(
                    f"registration of {signed.signer}: expected an end that is to come", "old_registration"
                )
            until_ms = min(message.until_ms, now_ms + message.lease_s * 1000)
            self._newest[key] = _Newest(message.counter, max(until_ms, newest.until_ms if newest else 0))
        elif newest is not None:
            newest.counter = message.counter
        if signed.is_expired and key not in leases:
            raise PayloadError(f"certificate of {signed.signer}: expired", "certificate")
        if message.control is Control.TAKE and (key not in leases or signed.is_expired):
            message = replace(message, control=Control.WANT)
        if signed.is_expired:
            message = _only(message, leases.held(key))
        return _within_rights(message, signed.certificate.rights)


def _question(message: Registration) -> Registration:
    """The challenge of another session of this activator before its birth (R9.6); it may not take a lease."""
    if message.lease_s != 0:
        raise PayloadError("registration: expected a ground station's", "old_registration")
    return message


def _only(message: Registration, held: frozenset[int]) -> Registration:
    """Reduce a registration to drones that its station controls already."""
    wanted = held if message.drones is None else held.intersection(message.drones)
    return replace(message, control=message.control if wanted else Control.NONE, drones=tuple(sorted(wanted)))


def _within_rights(message: Registration, rights: Rights) -> Registration:
    """Reduce a registration to its station's rights: takeover only with that right, and drones that it may command."""
    control, drones = message.control, message.drones
    if control is Control.TAKE and not rights.take_over:
        control = Control.WANT
    if rights.command is not None:
        drones = tuple(sorted(rights.command.intersection(rights.command if drones is None else drones)))
        control = control if drones else Control.NONE
    return replace(message, control=control, drones=drones)
