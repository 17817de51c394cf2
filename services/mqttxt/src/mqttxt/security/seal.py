"""Signs a node's messages and verifies those of others (docs/protocol.md, section 12)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cryptography.exceptions import InvalidSignature

from ..errors import ConfigurationError, PayloadError
from .certificate import Certificate
from .cose import KID_BYTES, Envelope, external_aad, to_be_signed
from .identity import Identity
from .names import Kind

EXPIRED = "expired"
MOST_CERTIFICATES = 4
"""Certificates kept of one name, the newest ones: more than a renewal needs."""


@dataclass(frozen=True)
class Signed:
    """A message signed with `certificate`, which is valid, or was valid when it was learned.

    `is_expired`: the certificate has expired since.
    """

    certificate: Certificate
    envelope: Envelope
    is_expired: bool = False

    @property
    def payload(self) -> bytes:
        return self.envelope.payload

    @property
    def signer(self) -> str:
        return self.certificate.name

    def before_its_end(self) -> Signed:
        """This message; raises PayloadError if the certificate has expired: then only what R12.4 names is accepted."""
        if self.is_expired:
            raise PayloadError(f"certificate of {self.signer}: {EXPIRED}", "certificate")
        return self


def is_drone(certificate: Certificate) -> bool:
    """Whether a certificate is a drone's."""
    return certificate.node.kind is Kind.DRONE


def is_station(certificate: Certificate) -> bool:
    """Whether a certificate is a ground station's."""
    return certificate.node.kind is Kind.STATION


class Seal:
    """Signs for one node, keeps the certificates of others, and verifies their signatures.

    `signs_states`: states are signed too, by default they are not; `signs_readings`: sensors sign their readings.
    """

    def __init__(self, identity: Identity, signs_states: bool = False, signs_readings: bool = False) -> None:
        self.name = identity.name
        self.identity = identity
        self.signs_states = signs_states
        self.signs_readings = signs_readings
        self._known: dict[str, list[Certificate]] = {identity.name: [identity.certificate]}

    @property
    def certificate(self) -> Certificate:
        """This node's own certificate, which may be renewed."""
        return self.identity.certificate

    def on_identity(self) -> bool:
        """Returns whether the identity was renewed since the last call. What either key signed is the node's own."""
        is_new = self.certificate not in self._known[self.name]
        self._keep(self.certificate)
        return is_new

    def sign(self, topic: str, payload: bytes, with_certificate: bool = False) -> Envelope:
        """Sign a payload for `topic`, which is named as in R12.3."""
        aad = external_aad(self.identity.fleet.key_hash, self.name, topic)
        signature = self.identity.sign(to_be_signed(payload, aad))
        certificate = self.certificate.der if with_certificate else None
        return Envelope(payload, self.certificate.hash[:KID_BYTES], signature, certificate)

    def open(self, topic: str, data: bytes, signer: str) -> Signed:
        """Verify a message of `signer` on `topic`; raises PayloadError for any other, which must have no effect.

        No relay adds a `route` to these messages, and many are passed on byte for byte.
        """
        signed = self.verified(Envelope.parse(data), lambda _: topic, lambda certificate: certificate.name == signer)
        if signed.envelope.route is not None:
            raise PayloadError("route: expected none", "not_signed")
        return signed

    def open_one_of(self, data: bytes, topics: dict[str, str]) -> Signed:
        """Verify a message of one of several signers, each on a topic of its own; raises PayloadError for any other."""
        return self.verified(
            Envelope.parse(data), lambda certificate: topics[certificate.name], lambda c: c.name in topics
        )

    def open_of_station(self, topic: str, envelope: Envelope) -> Signed:
        """Verify a message of any ground station on `topic`; raises PayloadError for any other."""
        return self.verified(envelope, lambda _: topic, is_station)

    def verified(
        self, envelope: Envelope, topic: Callable[[Certificate], str], expected: Callable[[Certificate], bool]
    ) -> Signed:
        """Verify a message of an `expected` signer on its `topic`; raises PayloadError for any other."""
        if envelope.certificate is not None:
            self._learn(envelope.certificate, expected)
        named = (known for certificates in self._known.values() for known in certificates)
        among = [known for known in named if known.hash[:KID_BYTES] == envelope.kid and expected(known)]
        if not among:
            raise PayloadError(f"kid {envelope.kid.hex()}: expected one of a known certificate", "unknown_signer")
        for certificate in among:
            aad = external_aad(self.identity.fleet.key_hash, certificate.name, topic(certificate))
            try:
                certificate.public_key.verify(envelope.signature, to_be_signed(envelope.payload, aad))
            except InvalidSignature:
                continue
            refusal = self.identity.time.verify(certificate)
            if refusal not in (None, EXPIRED):
                raise PayloadError(f"certificate of {certificate.name}: {refusal}", "certificate")
            return Signed(certificate, envelope, is_expired=refusal == EXPIRED)
        raise PayloadError(f"signature: expected one of {among[0].name} for this topic", "forged")

    def knows(self, name: str) -> bool:
        """Whether a certificate of that name is known and not revoked."""
        return any(known.serial not in self.identity.fleet.revoked.serials for known in self._known.get(name, ()))

    def _learn(self, der: bytes, expected: Callable[[Certificate], bool]) -> None:
        """Keep a valid certificate of an expected node; raises PayloadError for any other."""
        if any(known.der == der for certificates in self._known.values() for known in certificates):
            return
        try:
            certificate = Certificate.from_der(der)
        except ConfigurationError as error:
            raise PayloadError(str(error), "certificate") from error
        refusal = self.identity.time.verify(certificate)
        if refusal is not None or not expected(certificate):
            raise PayloadError(f"certificate of {certificate.name}: {refusal or 'of another node'}", "certificate")
        self._keep(certificate)

    def _keep(self, certificate: Certificate) -> None:
        known = self._known.setdefault(certificate.name, [])
        if certificate not in known:
            known.append(certificate)
            known.sort(key=lambda each: each.not_before_s)
            del known[:-MOST_CERTIFICATES]
