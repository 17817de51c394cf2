"""TLS alerts: why a broker ends a connection after the handshake."""

from __future__ import annotations

import contextlib
import ssl
from typing import Any

CERTIFICATE_REQUIRED = "certificate required"


class AlertSocket(ssl.SSLSocket):
    """Reports why the broker refuses this node.

    In TLS 1.3 a client has finished its handshake before the server refuses it: the alert arrives with the next read.
    """

    def heard(self, alert: str) -> None:
        """Called with the alert's name in lower case: `certificate required`, for example."""
        raise NotImplementedError

    def recv(self, buflen: int = 1024, flags: int = 0) -> bytes:
        try:
            return super().recv(buflen, flags)
        except ssl.SSLError as error:
            _, is_alert, said = (error.reason or "").partition("ALERT_")
            if is_alert:
                self.heard(said.replace("_", " ").lower())
            raise

    def send(self, data: Any, flags: int = 0) -> int:
        try:
            return super().send(data, flags)
        except (ConnectionError, ssl.SSLEOFError):  # the broker sent its alert before it closed
            with contextlib.suppress(OSError):
                self.recv(1)
            raise


def system_context() -> tuple[ssl.SSLContext, list[str]]:
    """A context that trusts the system's certificate authorities, and the list of alerts that its connections get."""
    context, alerts = ssl.create_default_context(), list[str]()

    class Socket(AlertSocket):
        def heard(self, alert: str) -> None:
            alerts.append(alert)

    context.sslsocket_class = Socket
    return context, alerts
