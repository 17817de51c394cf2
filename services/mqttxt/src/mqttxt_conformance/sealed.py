"""Signed messages in the kit: seals its own, and verifies those of others without mqttxt's code.

A fleet is a folder made by `mqttxt keys`, with the identities that the kit uses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cbor2
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256, Hash
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from cryptography.x509.oid import NameOID

from mqttxt.security.identity import Identity
from mqttxt.security.seal import Seal

from .registry import Broken, NotTested
from .tap import Heard

STATION, GUEST = "ops", "guest"
"""The stations that the kit plays: the first may command every drone, the second may only observe."""
_PROTECTED = cbor2.dumps({1: -8})
_KID, _CERTIFICATE, _ROUTE = 4, 33, -65537


@dataclass(frozen=True)
class Folder:
    """A fleet's folder, whether its messages are signed, and whether its sensors sign readings."""

    path: Path
    signed: bool
    signed_readings: bool = False

    def identity(self, name: str) -> Identity:
        """A node's identity; raises ConfigurationError if missing or invalid."""
        return Identity.load(self.path / name)

    def seal(self, name: str) -> Seal:
        return Seal(self.identity(name))

    def guest(self) -> Seal:
        """The seal of GUEST; raises NotTested if the fleet has none."""
        if not (self.path / f"gs-{GUEST}").is_dir():
            raise NotTested(f"needs a station without the right: mqttxt keys issue station {GUEST} --may observe")
        return self.seal(f"gs-{GUEST}")


@dataclass
class Speech:
    """Verifies the signatures of the messages that a tap receives.

    `signers` gives a topic's signer, with the topic that the signature names (R12.3) where that is another one; None
    for a topic that is not signed. `certificates` are those received so far, by name; `wrong` has the reason for each
    message that section 12 does not allow; `own` are payloads of the kit, which are not verified.
    """

    fleet: Identity
    signers: Callable[[str], str | tuple[str, str] | None]
    root: str = ""
    certificates: dict[str, x509.Certificate] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    own: set[bytes] = field(default_factory=set)
    verified: int = 0

    def read(self, heard: Heard) -> Heard:
        """The message with its envelope's payload; unchanged if it is not signed or cannot be verified."""
        signer = self.signers(heard.topic)
        if signer is None or not heard.payload or heard.payload in self.own:
            return heard
        name, topic = signer if isinstance(signer, tuple) else (signer, heard.topic.removeprefix(self.root))
        payload = self.checked(topic, heard.payload, name)
        return heard if payload is None else replace(heard, payload=payload)

    def checked(self, topic: str, data: bytes, signer: str) -> bytes | None:
        """The payload that `signer` signed for a topic (R12.3); None if it does not verify, with the reason in `wrong`.

        Before the signer's certificate has arrived nothing can be verified: None without a reason.
        """
        try:
            payload = self._opened(topic, data, signer)
        except Broken as broken:
            self.wrong.append(f"{topic}: {broken}")
            return None
        self.verified += payload is not None
        return payload

    def _opened(self, topic: str, data: bytes, signer: str) -> bytes | None:
        header, payload, signature = parts(data)
        if _CERTIFICATE in header:
            self._meet(header[_CERTIFICATE], signer)
        certificate = self.certificates.get(signer)
        if certificate is None:
            return None
        if header.get(_KID) != _hash(certificate.public_bytes(Encoding.DER))[:4]:
            raise Broken(f"kid {header.get(_KID)!r} is not of {signer}'s certificate")
        key = certificate.public_key()
        assert isinstance(key, Ed25519PublicKey)
        raw = self.fleet.fleet.authority.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
        aad = cbor2.dumps(["mqttxt1", _hash(raw), signer, topic], canonical=True)
        try:
            key.verify(signature, cbor2.dumps(["Signature1", _PROTECTED, aad, payload], canonical=True))
        except InvalidSignature:
            raise Broken(f"the signature is not {signer}'s for {topic}") from None
        return payload

    def _meet(self, der: bytes, signer: str) -> None:
        certificate = x509.load_der_x509_certificate(der)
        name = str(certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)
        try:
            certificate.verify_directly_issued_by(self.fleet.fleet.authority)
        except (ValueError, InvalidSignature):
            raise Broken(f"the certificate of {name} is not of the fleet") from None
        if name != signer:
            raise Broken(f"the certificate is {name}'s, expected {signer}'s")
        self.certificates[signer] = certificate


def parts(data: bytes) -> tuple[dict[int, Any], bytes, bytes]:
    """The unprotected header, payload and signature of a COSE_Sign1; raises Broken for anything else."""
    try:
        plain = cbor2.loads(data)
    except (cbor2.CBORDecodeError, ValueError, EOFError):
        raise Broken(f"not signed: {data[:24].hex(' ')} is no CBOR") from None
    if not isinstance(plain, list) or len(plain) != 4 or plain[0] != _PROTECTED or not isinstance(plain[1], dict):
        raise Broken(f"not signed: {data[:24].hex(' ')} …, expected COSE_Sign1 with {{1: -8}}")
    _, header, payload, signature = plain
    strange = set(header) - {_KID, _CERTIFICATE, _ROUTE}
    if strange or not isinstance(payload, bytes) or not isinstance(signature, bytes) or len(signature) != 64:
        raise Broken(f"an envelope with the header {sorted(map(str, header))} and {len(signature)} bytes of signature")
    return header, payload, signature


def addressed(data: bytes, drone: int) -> tuple[int, int, bytes]:
    """The activator's session and deadline of signed commands, and the envelope for one drone; raises Broken."""
    try:
        plain = cbor2.loads(data)
        version, session, deadline_ms, entries = plain[:4]
        envelope = dict(entries)[drone]
    except (cbor2.CBORDecodeError, ValueError, EOFError, TypeError, KeyError):
        raise Broken(f"{data[:24].hex(' ')} …, expected [1, session, deadline, [[{drone}, COSE_Sign1]]]") from None
    if version != 1 or type(session) is not int or type(deadline_ms) is not int:
        raise Broken(f"[{version}, {session}, {deadline_ms}, …], expected 1, a session and a deadline")
    return session, deadline_ms, cbor2.dumps(envelope, canonical=True)


def together(data: bytes) -> list[tuple[int, bytes]]:
    """The drone and the signed envelope of each word in words together; empty for a message signed as a whole."""
    plain = cbor2.loads(data)
    if not isinstance(plain, list) or len(plain) != 2:
        return []
    return [(number, cbor2.dumps(envelope, canonical=True)) for number, envelope in plain[1]]


def _hash(data: bytes) -> bytes:
    digest = Hash(SHA256())
    digest.update(data)
    return digest.finalize()
