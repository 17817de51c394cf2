"""COSE_Sign1 (RFC 9052) with EdDSA, untagged: the form of signed messages (docs/protocol.md, section 12)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cbor2

from ..errors import PayloadError
from ..protocol.cbor import MAX_PAYLOAD, parse_cbor

PROTECTED = cbor2.dumps({1: -8})
"""The protected header: EdDSA. It is the only algorithm, so that there is nothing to choose."""
SIGNED = b"\x84" + cbor2.dumps(PROTECTED)
"""The first bytes of every signed message, and of no other."""
KID, X5CHAIN, ROUTE = 4, 33, -65537
"""Labels of the unprotected header; the route's is for private use."""
KID_BYTES, SIGNATURE_BYTES = 4, 64
MOST_CERTIFICATE_BYTES = 2048
"""A station's certificate with every right, by single drones, has half of this. It is parsed before it is verified."""
CONTEXT = "mqttxt1"


@dataclass(frozen=True)
class Envelope:
    """A COSE_Sign1 message, whose signature is not verified yet. `payload` is the signed content.

    `kid` hints at the signer's certificate; a birth carries the `certificate` itself (DER). `route` is what a relay
    adds to the message that it passes on, and is not signed.
    """

    payload: bytes
    kid: bytes
    signature: bytes
    certificate: bytes | None = None
    route: Any = None

    def encode(self) -> bytes:
        """The bytes on the wire: deterministic CBOR."""
        return cbor2.dumps(self.plain(), canonical=True)

    def plain(self) -> list[Any]:
        """The message as CBOR values."""
        header: dict[int, Any] = {KID: self.kid, X5CHAIN: self.certificate, ROUTE: self.route}
        present = {label: value for label, value in header.items() if value is not None}
        return [PROTECTED, present, self.payload, self.signature]

    def routed(self, route: Any) -> Envelope:
        """The same message with a relay's addition."""
        return replace(self, route=route)

    def bare(self) -> Envelope:
        """The same message without its certificate, for receivers that have it."""
        return replace(self, certificate=None)

    @classmethod
    def parse(cls, data: bytes) -> Envelope:
        """Parse a message; raises PayloadError unless it is as section 12 has it. The signature is not verified."""
        return cls.of_plain(parse_cbor(data))

    @classmethod
    def of_plain(cls, plain: Any) -> Envelope:
        """`parse` for CBOR that is decoded already."""
        if not isinstance(plain, list) or len(plain) != 4 or plain[0] != PROTECTED or not isinstance(plain[1], dict):
            raise PayloadError("envelope: expected COSE_Sign1 with the protected header {1: -8}", "not_signed")
        _, header, payload, signature = plain
        kid, certificate = header.get(KID), header.get(X5CHAIN)
        is_whole = (
            not set(header) - {KID, X5CHAIN, ROUTE}
            and isinstance(kid, bytes)
            and len(kid) == KID_BYTES
            and (certificate is None or (isinstance(certificate, bytes) and len(certificate) <= MOST_CERTIFICATE_BYTES))
            and isinstance(payload, bytes)
            and isinstance(signature, bytes)
            and len(signature) == SIGNATURE_BYTES
        )
        if not is_whole or len(payload) > MAX_PAYLOAD:
            raise PayloadError("envelope: expected kid, payload and signature in their sizes", "not_signed")
        return cls(payload, kid, signature, certificate, header.get(ROUTE))


def external_aad(fleet: bytes, signer: str, topic: str) -> bytes:
    """What a signature covers besides the payload: SHA-256 of the authority's key, the signer's name, the topic."""
    return cbor2.dumps([CONTEXT, fleet, signer, topic], canonical=True)


def to_be_signed(payload: bytes, aad: bytes) -> bytes:
    """Sig_structure of RFC 9052, section 4.4."""
    return cbor2.dumps(["Signature1", PROTECTED, aad, payload], canonical=True)
