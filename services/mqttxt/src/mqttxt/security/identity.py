"""A node's identity: a folder with its key, its certificate, its fleet and the fleet's revocation list."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from ..errors import ConfigurationError
from . import files
from .certificate import Certificate
from .fleet import Fleet
from .trusted_time import TrustedTime

KEY_FILE = "identity.pem"
CERTIFICATE_FILE = "certificate.pem"
MEMBERS_FILE = "members.pem"
"""In a broker's identity: the fleet's valid certificates, from which its access list is made."""
_WRONG = {
    "other_fleet": "not issued by the authority in fleet.pem; expected a certificate of this fleet",
    "not_yet_valid": "not valid before {not_before}; expected a certificate that is valid now, or another clock",
    "expired": "expired at {not_after}; expected a valid one: `mqttxt keys renew {name}`",
    "revoked": "revoked; expected another certificate: `mqttxt keys issue`",
}


class Identity:
    """The identity of this process: it signs as `name`, with the key of `certificate`, in `fleet`, at `time`."""

    def __init__(
        self, folder: Path, key: Ed25519PrivateKey, certificate: Certificate, fleet: Fleet, time: TrustedTime
    ) -> None:
        self.folder = folder
        self.certificate = certificate
        self.fleet = fleet
        self.time = time
        self._key = key

    @property
    def name(self) -> str:
        return self.certificate.name

    @classmethod
    def load(cls, folder: Path, system: Callable[[], float] = time.time) -> Identity:
        """Load a folder; raises ConfigurationError, in one line, for the first thing that is wrong with it."""
        if not files.is_folder(folder, f"identity {folder}"):
            raise ConfigurationError(f"identity {folder}: no such folder; expected one of `mqttxt keys issue`")
        key = read_key(folder / KEY_FILE)
        certificate = read_certificate(folder / CERTIFICATE_FILE)
        fleet = Fleet.load(folder)
        check_pair(folder, key, certificate)
        now = TrustedTime(folder, fleet, system)
        check_valid(folder, certificate, now)
        return cls(folder, key, certificate, fleet, now)

    def in_folder(self) -> tuple[Ed25519PrivateKey, Certificate]:
        """The folder's present key and certificate; blocks.

        Raises ConfigurationError if a node would not start with them, or they are another node's.
        """
        key = read_key(self.folder / KEY_FILE)
        certificate = read_certificate(self.folder / CERTIFICATE_FILE)
        check_pair(self.folder, key, certificate)
        check_valid(self.folder, certificate, self.time)
        if certificate.name != self.name:
            raise ConfigurationError(
                f"{self.folder / CERTIFICATE_FILE}: {certificate.name}; expected a certificate of {self.name}"
            )
        return key, certificate

    def renew(self, key: Ed25519PrivateKey, certificate: Certificate) -> bool:
        """Sign with this key from now on; returns whether the certificate is a new one."""
        is_new = certificate != self.certificate
        self._key, self.certificate = key, certificate
        return is_new

    @property
    def wrong(self) -> str | None:
        """Why this node's own certificate is invalid now, in words; None while it is valid."""
        verdict = self.time.verify(self.certificate)
        return None if verdict is None else verdict.replace("_", " ")

    def sign(self, data: bytes) -> bytes:
        """The Ed25519 signature of `data`, 64 bytes."""
        return self._key.sign(data)


def read_key(path: Path) -> Ed25519PrivateKey:
    """Read a private key that only its owner can read; raises ConfigurationError."""
    try:
        key = load_pem_private_key(files.read(path, private=True), password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise ConfigurationError(f"{path}: not a private key in PEM without a password ({error})") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise ConfigurationError(f"{path}: expected an Ed25519 key")
    return key


def read_certificate(path: Path) -> Certificate:
    """Read a certificate; raises ConfigurationError."""
    return Certificate.from_pem(files.read(path), str(path))


def check_pair(folder: Path, key: Ed25519PrivateKey, certificate: Certificate) -> None:
    """Raises ConfigurationError if the certificate is another key's."""
    if key.public_key() != certificate.public_key:
        raise ConfigurationError(f"{folder / KEY_FILE}: not the key of {CERTIFICATE_FILE} ({certificate.name})")


def check_valid(folder: Path, certificate: Certificate, now: TrustedTime) -> None:
    """Raises ConfigurationError if a node would refuse the certificate."""
    wrong = now.verify(certificate)
    if wrong is None:
        return
    said = _WRONG[wrong].format(
        name=certificate.name,
        not_before=certificate.parsed.not_valid_before_utc,
        not_after=certificate.parsed.not_valid_after_utc,
    )
    raise ConfigurationError(f"{folder / CERTIFICATE_FILE}: {certificate.name}: {said}")
