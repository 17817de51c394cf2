"""Why a broker ends a TLS connection that was made: its alert."""

from __future__ import annotations

import contextlib
import ssl
from typing import Any

CERTIFICATE_REQUIRED = "certificate required"


class AlertSocket(ssl.SSLSocket):
    """Hears why the broker refuses this node.

    In TLS 1.3 a client has done its handshake when the server says no: that comes with what is read next.
    """

    def heard(self, alert: str) -> None:
        """Called with the alert's name in lower case, as `certificate required`."""
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
        except (ConnectionError, ssl.SSLEOFError):  # the broker has said why before it closed
            with contextlib.suppress(OSError):
                self.recv(1)
            raise


def system_context() -> tuple[ssl.SSLContext, list[str]]:
    """A context that trusts the system's certificate authorities, and the alerts that its connections hear."""
    context, alerts = ssl.create_default_context(), list[str]()

    class Socket(AlertSocket):
        def heard(self, alert: str) -> None:
            alerts.append(alert)

    context.sslsocket_class = Socket
    return context, alerts
