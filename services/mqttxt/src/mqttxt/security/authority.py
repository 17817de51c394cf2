"""A fleet's authority: a folder with the key that decides who belongs to the fleet, kept apart from all nodes.

FLEET/authority.pem   the authority's key (mode 0600)
FLEET/fleet.pem       its certificate, which every node has
FLEET/revoked.pem     the revocation list, which every node has
FLEET/issued/         every certificate that was ever issued
FLEET/NAME/           the identity of a node, to be copied to it
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from ..errors import ConfigurationError
from ..protocol.names import NAME, NAME_EXPECTED
from . import files
from .certificate import Certificate
from .fleet import FLEET_FILE, REVOKED_FILE, Fleet
from .identity import CERTIFICATE_FILE, KEY_FILE, MEMBERS_FILE, check_pair, read_certificate, read_key
from .names import Kind, NodeName
from .rights import Rights
from .signed_by_authority import AUTHORITY_DAYS, BACKDATED, self_signed, signed_certificate, signed_list

AUTHORITY_FILE = "authority.pem"
ISSUED = "issued"
NODE_DAYS = 365.0
STATION_DAYS = 90.0


class Authority:
    """Issues and revokes certificates. Each method raises ConfigurationError for invalid requests and file errors."""

    def __init__(self, folder: Path, key: Ed25519PrivateKey, fleet: Fleet) -> None:
        self.folder = folder
        self.fleet = fleet
        self._key = key

    @classmethod
    def create(cls, folder: Path, fleet: str) -> Authority:
        """Create a fleet in a folder that does not exist yet."""
        if not re.fullmatch(NAME, fleet):
            raise ConfigurationError(f"fleet name {fleet[:80]!r}: expected {NAME_EXPECTED}")
        try:
            folder.mkdir(mode=0o700, parents=True)
            (folder / ISSUED).mkdir()
        except OSError as error:
            raise ConfigurationError(f"{folder}: {error.strerror or error}; expected a new folder") from error
        key = Ed25519PrivateKey.generate()
        authority = self_signed(key, fleet)
        files.write(folder / AUTHORITY_FILE, _pem_of(key), 0o600)
        files.write(folder / FLEET_FILE, authority.public_bytes(Encoding.PEM))
        files.write(folder / REVOKED_FILE, signed_list(key, authority, 1, {}))
        return cls.load(folder)

    @classmethod
    def load(cls, folder: Path) -> Authority:
        """Load the fleet of a folder that `create` made."""
        if not files.is_there(folder / AUTHORITY_FILE):
            raise ConfigurationError(f"{folder}: no {AUTHORITY_FILE}; expected a folder of `mqttxt keys init`")
        key = read_key(folder / AUTHORITY_FILE)
        fleet = Fleet.load(folder)
        if fleet.authority.public_key() != key.public_key():
            raise ConfigurationError(f"{folder / AUTHORITY_FILE}: not the key of {FLEET_FILE}")
        return cls(folder, key, fleet)

    def issue(
        self,
        name: str,
        rights: Rights | None = None,
        days: float = NODE_DAYS,
        hosts: Iterable[str] = (),
        not_before: datetime | None = None,
    ) -> Path:
        """Issue a node's identity, in a folder of its name below the authority's; returns that folder.

        `hosts` are the names and addresses at which a broker is reached; loopback is always included. A revoked
        identity of the node is kept as `NAME~`.
        """
        self.check_new(name)
        node = NodeName.parse(name)
        folder = self.folder / str(node)
        fresh = self._made(node, rights or Rights(), days, tuple(hosts), not_before)
        self._put_in_place(fresh, folder)
        return folder

    def renew(self, name: str, days: float | None = None, hosts: Iterable[str] = ()) -> Path:
        """Issue a new key and certificate with the same rights; the old certificate stays valid until it ends.

        `hosts` replace those in a broker's certificate; if empty, those stay.

        The old identity is kept as `NAME~` until the next renewal. A revoked identity cannot be renewed.
        """
        node = NodeName.parse(name)
        folder = self.folder / str(node)
        if not files.is_folder(folder):
            raise ConfigurationError(f"{folder}: no such folder; expected a node that `mqttxt keys issue` made")
        old = self._current(node)
        if self._is_revoked(old):
            raise ConfigurationError(f"{folder}: revoked; expected `mqttxt keys issue`, with rights of its own")
        lifetime = days if days is not None else _days_of(old)
        self._put_in_place(self._made(node, old.rights, lifetime, tuple(hosts) or hosts_of(old), None), folder)
        return folder

    def revoke(self, name: str, only_old: bool = False) -> int:
        """Revoke every certificate of a node, or all but its newest; returns how many are newly revoked."""
        node = NodeName.parse(name)
        found = sorted((each for each in self.issued() if each.name == str(node)), key=lambda each: each.not_before_s)
        if not found:
            raise ConfigurationError(f"{node}: no certificate in {self.folder / ISSUED}; expected a node of this fleet")
        if only_old:
            current = self._current(node)
            found = [each for each in found if each != current]
        with files.locked(self.folder):
            self.fleet.take(self.fleet.in_folder())  # another process may have revoked meanwhile
            new = {each.serial for each in found} - self.fleet.revoked.serials
            if new:
                entries = _entries(self.fleet)
                entries |= dict.fromkeys(new, datetime.now(UTC))
                number = self.fleet.revoked.number + 1
                self.fleet.take(self.fleet.read(signed_list(self._key, self.fleet.authority, number, entries)))
                files.write(self.folder / REVOKED_FILE, self.fleet.revoked.pem())
                self._bring_up_to_date()
        return len(new)

    def issued(self) -> list[Certificate]:
        """Every certificate that was ever issued, in no order."""
        paths = sorted((self.folder / ISSUED).glob("*.pem"))
        return [Certificate.from_pem(files.read(path), str(path)) for path in paths]

    def members(self) -> list[Certificate]:
        """The certificates that are not revoked and have not expired."""
        now_s = datetime.now(UTC).timestamp()
        return [each for each in self.issued() if self.fleet.verify(each, now_s) in (None, "not_yet_valid")]

    def has(self, name: str) -> bool:
        """Whether a node has an identity here that is not revoked."""
        node = NodeName.parse(name)
        return (self.folder / str(node)).exists() and not self._is_revoked(self._current(node))

    def check_new(self, name: str) -> None:
        """Raises ConfigurationError if a node has an identity here that is not revoked."""
        if self.has(name):
            node = NodeName.parse(name)
            raise ConfigurationError(
                f"{self.folder / str(node)}: is there; expected a node that has no identity yet; for a new key "
                f"`mqttxt keys renew {node}`, for other rights `mqttxt keys revoke {node}` before"
            )

    def _current(self, node: NodeName) -> Certificate:
        """The certificate in a node's folder; raises ConfigurationError."""
        return read_certificate(self.folder / str(node) / CERTIFICATE_FILE)

    def _is_revoked(self, certificate: Certificate) -> bool:
        return certificate.serial in self.fleet.revoked.serials

    def _put_in_place(self, fresh: Path, folder: Path) -> None:
        """Move a new identity to its node's name; the one before is kept beside it."""
        before = folder.with_name(f"{folder.name}~")  # not a valid node name
        with files.changing(folder):
            if folder.exists():
                shutil.rmtree(before, ignore_errors=True)
                folder.rename(before)
            fresh.rename(folder)
        with files.locked(self.folder):
            self.fleet.take(self.fleet.in_folder())
            self._bring_up_to_date()

    def _made(
        self,
        node: NodeName,
        rights: Rights,
        days: float,
        hosts: tuple[str, ...],
        not_before: datetime | None,
    ) -> Path:
        """Make a whole identity in a temporary folder, which the caller renames."""
        if rights != Rights() and node.kind is not Kind.STATION:
            raise ConfigurationError(f"rights for {node}: expected a station")
        if hosts and node.kind is not Kind.BROKER:
            raise ConfigurationError(f"hosts for {node}: expected a broker")
        if not 0 < days <= AUTHORITY_DAYS:
            raise ConfigurationError(f"days {days:g}: expected more than 0 and at most {AUTHORITY_DAYS}")
        now = datetime.now(UTC)
        start = not_before or now - BACKDATED
        end = min((not_before or now) + timedelta(days=days), self.fleet.authority.not_valid_after_utc)
        if not_before is None and end.replace(microsecond=0) <= now:  # a certificate has whole seconds
            raise ConfigurationError(
                f"days {days:g}: it would end at {end:%Y-%m-%d %H:%M:%S} UTC; expected a later end"
            )
        key = Ed25519PrivateKey.generate()
        certificate = signed_certificate(self._key, self.fleet, key.public_key(), node, rights, hosts, start, end)
        folder = self.folder / f".{node}.new"
        with files.changing(folder):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(mode=0o700)
        files.write(folder / KEY_FILE, _pem_of(key), 0o600)
        files.write(folder / CERTIFICATE_FILE, certificate)
        files.write(folder / FLEET_FILE, files.read(self.folder / FLEET_FILE))
        files.write(folder / REVOKED_FILE, files.read(self.folder / REVOKED_FILE))
        found = Certificate.from_pem(certificate)
        check_pair(folder, key, found)
        files.write(self.folder / ISSUED / f"{node}-{found.hash.hex()[:16]}.pem", certificate)
        return folder

    def _bring_up_to_date(self) -> None:
        """Write the newest list into every identity below the authority's folder, and the members into brokers'."""
        revoked = files.read(self.folder / REVOKED_FILE)
        members = b"".join(each.parsed.public_bytes(Encoding.PEM) for each in self.members())
        for certificate in sorted(self.folder.glob(f"[!.]*/{CERTIFICATE_FILE}")):
            folder = certificate.parent
            files.write(folder / REVOKED_FILE, revoked)
            if Certificate.from_pem(files.read(certificate), str(certificate)).node.kind is Kind.BROKER:
                files.write(folder / MEMBERS_FILE, members)


def _days_of(certificate: Certificate) -> float:
    """The days for which a certificate was issued: those of `issue`, which dates its start back."""
    return (certificate.not_after_s - certificate.not_before_s - BACKDATED.total_seconds()) / 86_400


def hosts_of(certificate: Certificate) -> tuple[str, ...]:
    """The names and addresses in a broker's certificate."""
    found = certificate.parsed.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    addresses = [str(address) for address in found.get_values_for_type(x509.IPAddress)]
    return (*found.get_values_for_type(x509.DNSName), *addresses)


def _entries(fleet: Fleet) -> dict[int, datetime]:
    found = x509.load_der_x509_crl(fleet.revoked.der)
    return {entry.serial_number: entry.revocation_date_utc for entry in found}


def _pem_of(key: Ed25519PrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
