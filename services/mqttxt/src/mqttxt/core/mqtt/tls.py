"""Mutual TLS 1.3 with a node's identity: which brokers a connection trusts, and which certificate it shows."""

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
"""The environment variable, common to many programs, that names a file for session keys; they decrypt captures."""
_NO_CHECK_TIME = ssl.VerifyFlags(0x200000)
"""X509_V_FLAG_NO_CHECK_TIME: the system's clock may show 1970, so the handshake here goes by the trusted time."""


class FleetContext(ssl.SSLContext):
    """The TLS context of one connection; `alert` is the broker's reason if it refused this node."""

    identity: Identity
    alert: str | None = None


class FleetSocket(AlertSocket):
    """Verifies the broker's certificate before a byte of MQTT is sent."""

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
    """Make the context of one connection to a broker of the node's fleet: TLS 1.3 only, with the broker's name checked.

    The handshake fails unless the broker's certificate is of this fleet, valid at the trusted time and not revoked.
    Raises OSError if the identity's files, or the file for session keys, cannot be used.
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
    """Warn once per file: writing keys is for measurements, and should be noticed at once."""
    logger.warning("%s: session keys are written to %s; who has them can decrypt this node's traffic", KEY_LOG, path)


def wrong_with(identity: Identity, der: bytes | None) -> str | None:
    """Why the certificate `der` is not that of a broker of the fleet, as text; None if it is."""
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
