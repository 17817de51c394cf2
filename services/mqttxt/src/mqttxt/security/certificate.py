"""A node's certificate: an X.509 certificate with an Ed25519 key, the node's name and its rights."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, field
from typing import TypeVar

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ..errors import ConfigurationError
from ..protocol.names import NAME, NAME_EXPECTED
from .names import Kind, NodeName
from .rights import FLEET, SCHEME, Rights

UNREADABLE = (
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    x509.InvalidVersion,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
)
"""The exceptions that `cryptography` raises on invalid bytes."""

_Extension = TypeVar("_Extension", bound=x509.ExtensionType)


def usage_of(kind: Kind) -> x509.ObjectIdentifier:
    """The TLS usage of a node's key: a broker is a server, all others are clients."""
    return ExtendedKeyUsageOID.SERVER_AUTH if kind is Kind.BROKER else ExtendedKeyUsageOID.CLIENT_AUTH


@dataclass(frozen=True)
class Certificate:
    """A parsed certificate; `Fleet.verify` tells whether the fleet signed it and whether it is valid.

    `name` is the node's (`drone3`, `gs-ops`); times are Unix seconds, both inclusive; `hash` is the SHA-256 of `der`.
    """

    der: bytes = field(repr=False)
    name: str = field(compare=False)
    node: NodeName = field(compare=False)
    fleet: str = field(compare=False)
    rights: Rights = field(compare=False)
    public_key: Ed25519PublicKey = field(compare=False, repr=False)
    serial: int = field(compare=False)
    not_before_s: int = field(compare=False)
    not_after_s: int = field(compare=False)
    hash: bytes = field(compare=False, repr=False)
    parsed: x509.Certificate = field(compare=False, repr=False)

    @classmethod
    def from_der(cls, der: bytes, what: str = "certificate") -> Certificate:
        """Parse DER; raises ConfigurationError, prefixed with `what`, for anything but a node's certificate."""
        try:
            found = x509.load_der_x509_certificate(der)
            key = found.public_key()
            extensions = found.extensions
        except UNREADABLE as error:
            raise ConfigurationError(f"{what}: not an X.509 certificate ({error})") from error
        if not isinstance(key, Ed25519PublicKey):
            raise ConfigurationError(f"{what}: expected an Ed25519 key")
        try:
            return cls._of(found, key, extensions)
        except (ConfigurationError, *UNREADABLE) as error:
            raise ConfigurationError(f"{what}: {error}") from error

    @classmethod
    def from_pem(cls, pem: bytes, what: str = "certificate") -> Certificate:
        """The only certificate of a PEM file; raises ConfigurationError."""
        try:
            found = x509.load_pem_x509_certificates(pem)
        except UNREADABLE as error:
            raise ConfigurationError(f"{what}: not a certificate in PEM; expected a certificate") from error
        if len(found) != 1:
            raise ConfigurationError(f"{what}: {len(found)} certificates; expected one")
        return cls.from_der(found[0].public_bytes(Encoding.DER), what)

    @classmethod
    def all_from_pem(cls, pem: bytes, what: str) -> list[Certificate]:
        """Every certificate of a PEM file, none if it is empty; raises ConfigurationError."""
        try:
            found = x509.load_pem_x509_certificates(pem) if pem.strip() else []
        except UNREADABLE as error:
            raise ConfigurationError(f"{what}: not certificates in PEM ({error})") from error
        return [cls.from_der(each.public_bytes(Encoding.DER), what) for each in found]

    @classmethod
    def _of(cls, found: x509.Certificate, key: Ed25519PublicKey, extensions: x509.Extensions) -> Certificate:
        names = found.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        if len(names) != 1:
            raise ConfigurationError(f"{len(names)} common names; expected one")
        node = NodeName.parse(str(names[0].value))
        constraints = _extension(extensions, x509.BasicConstraints)
        if constraints is None or constraints.ca:
            raise ConfigurationError("not a node's; expected basic constraints CA:FALSE")
        usage = _extension(extensions, x509.ExtendedKeyUsage)
        if usage is None or list(usage) != [usage_of(node.kind)]:
            expected = "serverAuth" if node.kind is Kind.BROKER else "clientAuth"
            raise ConfigurationError(f"extended key usage of {node}: expected {expected} alone")
        alternatives = _extension(extensions, x509.SubjectAlternativeName)
        uris = alternatives.get_values_for_type(x509.UniformResourceIdentifier) if alternatives is not None else []
        fleets = [uri.removeprefix(FLEET) for uri in uris if uri.startswith(FLEET)]
        if len(fleets) != 1:
            raise ConfigurationError(f"{len(fleets)} fleets; expected one URI {FLEET}NAME")
        if not re.fullmatch(NAME, fleets[0]):
            raise ConfigurationError(f"fleet {fleets[0][:80]!r}: expected {NAME_EXPECTED}")
        rights = Rights.of_uris(uri for uri in uris if uri.startswith(SCHEME) and not uri.startswith(FLEET))
        if rights != Rights() and node.kind is not Kind.STATION:
            raise ConfigurationError(f"rights of {node}: expected them of stations alone")
        der = found.public_bytes(Encoding.DER)
        return cls(
            der=der,
            name=str(node),
            node=node,
            fleet=fleets[0],
            rights=rights,
            public_key=key,
            serial=found.serial_number,
            not_before_s=int(found.not_valid_before_utc.timestamp()),
            not_after_s=int(found.not_valid_after_utc.timestamp()),
            hash=hashlib.sha256(der).digest(),
            parsed=found,
        )


def _extension(extensions: x509.Extensions, kind: type[_Extension]) -> _Extension | None:
    found = [each.value for each in extensions if isinstance(each.value, kind)]
    return found[0] if found else None
