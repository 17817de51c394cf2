"""Mutual TLS 1.3 with a node's identity: whom a connection trusts, and what it shows."""

from __future__ import annotations

import ssl

from ...errors import ConfigurationError
from ...security.certificate import Certificate
from ...security.fleet import FLEET_FILE
from ...security.identity import CERTIFICATE_FILE, KEY_FILE, Identity
from ...security.names import Kind

_NO_CHECK_TIME = ssl.VerifyFlags(0x200000)
"""X509_V_FLAG_NO_CHECK_TIME: the system's clock may be in 1970; the handshake here judges by the trusted time."""


def client_context(identity: Identity) -> ssl.SSLContext:
    """For connections as a node to brokers of its fleet: TLS 1.3 alone, the broker's name checked.

    The broker's certificate is of this fleet, valid at the trusted time and not revoked, or the handshake fails.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_verify_locations(identity.folder / FLEET_FILE)
    context.load_cert_chain(identity.folder / CERTIFICATE_FILE, identity.folder / KEY_FILE)
    context.verify_flags |= _NO_CHECK_TIME

    class FleetSocket(ssl.SSLSocket):
        """Looks at the broker's certificate before a byte of MQTT is sent."""

        def do_handshake(self, block: bool = False) -> None:
            super().do_handshake(block)
            wrong = _wrong_with(identity, self.getpeercert(binary_form=True))
            if wrong is not None:
                self.close()
                raise ssl.SSLCertVerificationError(wrong)

    context.sslsocket_class = FleetSocket
    return context


def _wrong_with(identity: Identity, der: bytes | None) -> str | None:
    """Why a peer is no broker of the fleet; None where it is one."""
    if der is None:
        return "it shows no certificate"
    try:
        certificate = Certificate.from_der(der, "its certificate")
    except ConfigurationError as error:
        return str(error)
    if certificate.node.kind is not Kind.BROKER:
        return f"its certificate is {certificate.name}'s; expected a broker's"
    verdict = identity.fleet.verify(certificate, identity.time.now_s())
    return None if verdict is None else f"its certificate ({certificate.name}) is {verdict.replace('_', ' ')}"
