"""Mutual TLS 1.3 with a node's identity: whom a connection trusts, and what it shows."""

from __future__ import annotations

import functools
import logging
import os
import ssl

from ...errors import ConfigurationError
from ...security.certificate import Certificate
from ...security.fleet import FLEET_FILE
from ...security.identity import CERTIFICATE_FILE, KEY_FILE, Identity
from ...security.names import Kind
from .alerts import AlertSocket

logger = logging.getLogger("mqttxt.tls")

KEY_LOG = "SSLKEYLOGFILE"
"""The environment's variable, of many programs, that names a file for session keys: whoever has them reads captures."""
_NO_CHECK_TIME = ssl.VerifyFlags(0x200000)
"""X509_V_FLAG_NO_CHECK_TIME: the system's clock may be in 1970; the handshake here judges by the trusted time."""


class FleetContext(ssl.SSLContext):
    """For one connection: what the node trusts and shows, and in `alert` why the broker refused it, if it did."""

    identity: Identity
    alert: str | None = None


class FleetSocket(AlertSocket):
    """Looks at the broker's certificate before a byte of MQTT is sent."""

    def do_handshake(self, block: bool = False) -> None:
        super().do_handshake(block)
        wrong = wrong_with(self._fleet.identity, self.getpeercert(binary_form=True))
        if wrong is not None:
            self.close()
            raise ssl.SSLCertVerificationError(ssl.SSLErrorNumber.SSL_ERROR_SSL, wrong)

    def heard(self, alert: str) -> None:
        self._fleet.alert = alert

    @property
    def _fleet(self) -> FleetContext:
        assert isinstance(self.context, FleetContext)
        return self.context


def client_context(identity: Identity) -> FleetContext:
    """For one connection as a node to a broker of its fleet: TLS 1.3 alone, the broker's name checked.

    The broker's certificate is of this fleet, valid at the trusted time and not revoked, or the handshake fails.
    Raises OSError where the identity's files, or the file for session keys, cannot be used.
    """
    context = FleetContext(ssl.PROTOCOL_TLS_CLIENT)
    context.identity = identity
    context.sslsocket_class = FleetSocket
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_verify_locations(identity.folder / FLEET_FILE)
    context.load_cert_chain(identity.folder / CERTIFICATE_FILE, identity.folder / KEY_FILE)
    context.verify_flags |= _NO_CHECK_TIME
    if path := os.environ.get(KEY_LOG):
        _tell_of_keys(path)
        try:
            context.keylog_filename = path
        except OSError as error:
            raise OSError(error.errno, f"{KEY_LOG} {path}: {error.strerror}") from error
    return context


@functools.cache
def _tell_of_keys(path: str) -> None:
    """Once: it is for measurements, and nobody is to find it out late."""
    logger.warning("%s: session keys are written to %s; who has them can decrypt this node's traffic", KEY_LOG, path)


def wrong_with(identity: Identity, der: bytes | None) -> str | None:
    """Why a peer is no broker of the fleet; None where it is one."""
    if der is None:
        return "it shows no certificate"
    try:
        certificate = Certificate.from_der(der, "its certificate")
    except ConfigurationError as error:
        return str(error)
    if certificate.node.kind is not Kind.BROKER:
        return f"its certificate is {certificate.name}'s; expected a broker's"
    verdict = identity.time.verify(certificate)
    return None if verdict is None else f"its certificate ({certificate.name}) is {verdict.replace('_', ' ')}"
