"""A fleet's revocation list: an X.509 CRL with a number that only rises."""

from __future__ import annotations

from dataclasses import dataclass, field

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding

from ..errors import ConfigurationError
from .certificate import UNREADABLE


@dataclass(frozen=True)
class RevocationList:
    """The revoked serial numbers as of `this_update_s` (Unix seconds); a higher `number` replaces a lower one."""

    der: bytes = field(repr=False)
    number: int
    this_update_s: int
    serials: frozenset[int]

    @classmethod
    def of(cls, encoded: bytes, authority: Ed25519PublicKey, what: str = "revocation list") -> RevocationList:
        """Parse PEM or DER; raises ConfigurationError if it is no list, or not this authority's."""
        try:
            is_pem = encoded.lstrip().startswith(b"-----BEGIN")
            found = x509.load_pem_x509_crl(encoded) if is_pem else x509.load_der_x509_crl(encoded)
            if not found.is_signature_valid(authority):
                raise ConfigurationError(f"{what}: not signed by this fleet's authority")
            extensions = found.extensions
            serials = frozenset(entry.serial_number for entry in found)
        except UNREADABLE as error:
            raise ConfigurationError(f"{what}: not a certificate revocation list ({error})") from error
        numbers = [each.value.crl_number for each in extensions if isinstance(each.value, x509.CRLNumber)]
        if len(numbers) != 1:
            raise ConfigurationError(f"{what}: no CRLNumber; expected one made by `mqttxt keys`")
        return cls(
            der=found.public_bytes(Encoding.DER),
            number=numbers[0],
            this_update_s=int(found.last_update_utc.timestamp()),
            serials=serials,
        )

    def pem(self) -> bytes:
        """The list in PEM, as files have it."""
        return x509.load_der_x509_crl(self.der).public_bytes(Encoding.PEM)
