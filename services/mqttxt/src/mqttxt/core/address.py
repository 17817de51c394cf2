"""Where a broker is, as a person writes it; and hosts and numbers in any address."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from urllib.parse import unquote, urlsplit

from ..errors import ConfigurationError


@dataclass(frozen=True)
class BrokerAddress:
    """Where a broker is: `mqtt://[user:password@]host[:port]`, `mqtts://` for TLS."""

    host: str
    port: int
    tls: bool = False
    username: str | None = None
    password: str | None = None

    @classmethod
    def parse(cls, url: str, what: str = "broker") -> BrokerAddress:
        """Raises ConfigurationError where `url` is no broker's."""
        expected = "expected mqtt://HOST[:PORT] or mqtts://HOST[:PORT]"
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise ConfigurationError(f"{what} {url!r}: {error}; {expected}") from error
        beside = parts.path.strip("/") or parts.query or parts.fragment
        if parts.scheme not in ("mqtt", "mqtts") or beside or not is_host(parts.hostname or "") or port == 0:
            raise ConfigurationError(f"{what} {url!r}: {expected}")
        assert parts.hostname is not None
        tls = parts.scheme == "mqtts"
        return cls(
            parts.hostname,
            port or (8883 if tls else 1883),
            tls,
            unquote(parts.username) if parts.username else None,
            unquote(parts.password) if parts.password else None,
        )

    @property
    def is_loopback(self) -> bool:
        """Whether what is sent there stays on this machine."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def __str__(self) -> str:
        return f"{'mqtts' if self.tls else 'mqtt'}://{self.host}:{self.port}"


def is_host(text: str) -> bool:
    """Whether a name or an address can be looked up at all: DNS takes labels of 1 to 63 characters."""
    try:
        return text != "" and "\0" not in text and text.encode("idna") != b""
    except UnicodeError:
        return False


def whole_number(text: str, most: int) -> int | None:
    """The number from 1 to `most` in ASCII digits, None where `text` is none."""
    if not (text.isascii() and text.isdecimal() and len(text) <= len(str(most))):
        return None
    return int(text) if 1 <= int(text) <= most else None
