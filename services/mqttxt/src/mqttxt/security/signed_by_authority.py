"""The documents that an authority's key signs: its own certificate, the nodes' and the revocation list."""

from __future__ import annotations

import ipaddress
import re
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from ..errors import ConfigurationError
from .certificate import usage_of
from .fleet import Fleet
from .names import Kind, NodeName
from .rights import FLEET, Rights

AUTHORITY_DAYS = 10_957
"""30 years: an authority is not renewed; a new fleet is made instead."""
BACKDATED = timedelta(minutes=5)
"""How far the start of validity is dated back, because the clocks of a fleet's machines differ."""
_HOST = re.compile(r"(?!(.*\.)?[0-9]+$)[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*")
"""A DNS name. What ends with a number is an address, or one with a mistake (RFC 1123, 2.1)."""
_LOOPBACK = ("127.0.0.1", "::1")


def self_signed(key: Ed25519PrivateKey, fleet: str) -> x509.Certificate:
    """A new fleet's certificate, signed by its own key."""
    start = datetime.now(UTC) - BACKDATED
    key_id = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    builder = (
        x509.CertificateBuilder()
        .subject_name(_common_name(fleet))
        .issuer_name(_common_name(fleet))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(start + timedelta(days=AUTHORITY_DAYS))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(key_cert_sign=True, crl_sign=True), critical=True)
        .add_extension(key_id, critical=False)
    )
    return builder.sign(key, None)


def signed_certificate(
    key: Ed25519PrivateKey,
    fleet: Fleet,
    of: Ed25519PublicKey,
    node: NodeName,
    rights: Rights,
    hosts: tuple[str, ...],
    start: datetime,
    end: datetime,
) -> bytes:
    """A certificate in PEM for a node whose key is `of`; raises ConfigurationError for an invalid host."""
    uris = (FLEET + fleet.name, *rights.uris())
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(uri) for uri in uris]
    if node.kind is Kind.BROKER:
        names += [_host(host) for host in dict.fromkeys(("localhost", *_LOOPBACK, *hosts))]
    authority_key = x509.AuthorityKeyIdentifier.from_issuer_public_key(key.public_key())
    builder = (
        x509.CertificateBuilder()
        .subject_name(_common_name(str(node)))
        .issuer_name(fleet.authority.subject)
        .public_key(of)
        .serial_number(x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(end)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(digital_signature=True), critical=True)
        .add_extension(x509.ExtendedKeyUsage([usage_of(node.kind)]), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(authority_key, critical=False)
    )
    return builder.sign(key, None).public_bytes(Encoding.PEM)


def signed_list(
    key: Ed25519PrivateKey, authority: x509.Certificate, number: int, entries: dict[int, datetime]
) -> bytes:
    """A revocation list in PEM, valid as long as the authority: past `nextUpdate` OpenSSL would refuse everyone."""
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(authority.subject)
        .last_update(datetime.now(UTC) - BACKDATED)
        .next_update(authority.not_valid_after_utc)
        .add_extension(x509.CRLNumber(number), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(key.public_key()), critical=False)
    )
    for serial, at in sorted(entries.items()):
        entry = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(at)
        builder = builder.add_revoked_certificate(entry.build())
    return builder.sign(key, None).public_bytes(Encoding.PEM)


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        if len(host) > 253 or not _HOST.fullmatch(host):
            raise ConfigurationError(f"host {host!r}: expected a DNS name or an address") from None
        return x509.DNSName(host)


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _key_usage(digital_signature: bool = False, key_cert_sign: bool = False, crl_sign: bool = False) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=digital_signature,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=key_cert_sign,
        crl_sign=crl_sign,
        encipher_only=False,
        decipher_only=False,
    )
