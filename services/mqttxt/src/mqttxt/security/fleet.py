"""A fleet as its nodes have it: the authority's certificate, and the newest revocation list."""

from __future__ import annotations

import hashlib
import logging
import threading
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from cryptography.x509.oid import NameOID

from ..errors import ConfigurationError
from . import files
from .certificate import UNREADABLE, Certificate
from .revocation import RevocationList

logger = logging.getLogger("mqttxt.identity")

FLEET_FILE = "fleet.pem"
REVOKED_FILE = "revoked.pem"
NEWEST_FILE = "newest.pem"
"""The newest revocation list that a node has had, whatever REVOKED_FILE has now."""
_MOST_KNOWN = 4096


class Fleet:
    """Verifies certificates. `name` is the fleet's, `key_hash` the SHA-256 of the authority's key.

    `load` reads the files of a folder; raises ConfigurationError if one is wrong, but for NEWEST_FILE.
    """

    def __init__(self, authority: x509.Certificate, revoked: RevocationList, folder: Path | None = None) -> None:
        key = authority.public_key()
        assert isinstance(key, Ed25519PublicKey)
        self.name = str(authority.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)
        self.key_hash = hashlib.sha256(key.public_bytes(Encoding.Raw, PublicFormat.Raw)).digest()
        self.authority = authority
        self.revoked = revoked
        self._key = key
        self._folder = folder
        self._keeping = threading.Lock()
        self._signed: set[bytes] = set()

    @classmethod
    def load(cls, folder: Path) -> Fleet:
        path = folder / FLEET_FILE
        authority = read_authority(files.read(path), str(path))
        key = authority.public_key()
        assert isinstance(key, Ed25519PublicKey)
        lists = [RevocationList.of(files.read(folder / REVOKED_FILE), key, str(folder / REVOKED_FILE))]
        if (folder / NEWEST_FILE).exists():
            try:
                lists.append(RevocationList.of(files.read(folder / NEWEST_FILE), key, str(folder / NEWEST_FILE)))
            except ConfigurationError as error:  # as after a power loss
                logger.error("%s; %s counts, until a newer list comes", error, REVOKED_FILE)
        return cls(authority, max(lists, key=lambda each: each.number), folder)

    @property
    def not_after_s(self) -> int:
        """When the authority's own certificate expires, in Unix seconds."""
        return int(self.authority.not_valid_after_utc.timestamp())

    def verify(self, certificate: Certificate, at_s: float) -> str | None:
        """Why a certificate is invalid at a Unix time; None if it is valid.

        `other_fleet`, `not_yet_valid`, `expired` or `revoked`.
        """
        if not self._is_signed(certificate):
            return "other_fleet"
        if certificate.serial in self.revoked.serials:
            return "revoked"
        if at_s < certificate.not_before_s:
            return "not_yet_valid"
        if at_s > min(certificate.not_after_s, self.not_after_s):
            return "expired"
        return None

    def read(self, encoded: bytes, what: str = "revocation list") -> RevocationList:
        """Parse a revocation list of this fleet, older or newer; raises ConfigurationError for any other."""
        return RevocationList.of(encoded, self._key, what)

    def take(self, found: RevocationList) -> bool:
        """Use a list of this fleet from now on if it is newer; returns whether it is.

        `keep` writes it to the folder.
        """
        if found.number <= self.revoked.number:
            return False
        self.revoked = found
        return True

    def in_folder(self) -> RevocationList:
        """The folder's present list; blocks. Raises ConfigurationError."""
        if self._folder is None:
            return self.revoked
        return self.read(files.read(self._folder / REVOKED_FILE), str(self._folder / REVOKED_FILE))

    def keep(self) -> None:
        """Write the list to the folder, except over a newer one there; blocks. Raises ConfigurationError."""
        if self._folder is None:
            return
        with self._keeping:
            own = self.revoked  # `take` may replace it meanwhile
            pem = own.pem()
            for path in (self._folder / NEWEST_FILE, self._folder / REVOKED_FILE):
                if not path.exists() or self._is_to_replace(path, own, pem):
                    files.write(path, pem)

    def _is_to_replace(self, path: Path, own: RevocationList, pem: bytes) -> bool:
        """Whether a file has another list than `own`, whose PEM is `pem`, and no newer one of the fleet."""
        try:
            found = files.read(path)
            return found != pem and self.read(found).number <= own.number
        except ConfigurationError:
            return True

    def _is_signed(self, certificate: Certificate) -> bool:
        """Whether the authority signed a certificate. Verified once, because many messages use the same one."""
        if certificate.hash in self._signed:
            return True
        if certificate.fleet != self.name:
            return False
        try:
            certificate.parsed.verify_directly_issued_by(self.authority)
        except (InvalidSignature, *UNREADABLE):
            return False
        if len(self._signed) >= _MOST_KNOWN:
            self._signed.clear()
        self._signed.add(certificate.hash)
        return True


def read_authority(pem: bytes, what: str) -> x509.Certificate:
    """The authority's own certificate; raises ConfigurationError."""
    try:
        found = x509.load_pem_x509_certificates(pem)
        if len(found) != 1:
            raise ConfigurationError(f"{what}: {len(found)} certificates; expected the authority's alone")
        authority, key = found[0], found[0].public_key()
        constraints = [each.value for each in authority.extensions if isinstance(each.value, x509.BasicConstraints)]
        names = authority.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        authority.verify_directly_issued_by(authority)
    except (InvalidSignature, *UNREADABLE) as error:
        raise ConfigurationError(f"{what}: not a fleet authority's certificate ({error})") from error
    if not (isinstance(key, Ed25519PublicKey) and len(names) == 1 and constraints and constraints[0].ca):
        raise ConfigurationError(f"{what}: not a fleet authority's certificate; expected one of `mqttxt keys init`")
    return authority
