"""Broker addresses as people write them; hosts and numbers in any address."""

from __future__ import annotations

import errno
import ipaddress
import re
import socket
from dataclasses import dataclass
from urllib.parse import unquote, urlsplit

from ..errors import ConfigurationError

SN = "mqtt-sn"
_NOT_IN_HOSTS = re.compile(r"[\s/?#@\[\]\\]")
"""The characters that end a host in a URL (RFC 3986, 3.2), and those that end a word in a broker's configuration."""
_PASSWORD = re.compile(r"(://[^:/?#@]*:).*@", re.DOTALL)


@dataclass(frozen=True)
class BrokerAddress:
    """The address of a broker: `mqtt://[user:password@]host[:port]`, `mqtts://` for TLS.

    `mqtt-sn://host[:port]` is an activator's gateway for MQTT-SN over UDP (`datagrams`).
    """

    host: str
    port: int
    tls: bool = False
    username: str | None = None
    password: str | None = None
    datagrams: bool = False

    @classmethod
    def parse(cls, url: str, what: str = "broker", datagrams: bool = False) -> BrokerAddress:
        """Parse a broker's URL, or with `datagrams` a gateway's; raises ConfigurationError, which names it `what`."""
        schemes = ("mqtt", "mqtts", SN) if datagrams else ("mqtt", "mqtts")
        forms = [f"{scheme}://HOST[:PORT]" for scheme in schemes]
        shown = _PASSWORD.sub(r"\1***@", url)
        wrong = f"{what} {shown!r}: expected {', '.join(forms[:-1])} or {forms[-1]}, with a port from 1 to 65535"
        if not url.isprintable() or " " in url:  # `urlsplit` drops some of these
            raise ConfigurationError(wrong)
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError:  # its text may contain a part of the password
            raise ConfigurationError(wrong) from None
        has_user = parts.scheme == SN and "@" in parts.netloc  # no packet of MQTT-SN has a place for one
        beside = parts.path.strip("/") or parts.query or parts.fragment
        if parts.scheme not in schemes or has_user or beside or not is_host(parts.hostname or "") or port == 0:
            raise ConfigurationError(wrong)
        assert parts.hostname is not None
        tls = parts.scheme == "mqtts"
        return cls(
            parts.hostname,
            port or (8883 if tls else 1883),
            tls,
            unquote(parts.username) if parts.username else None,
            unquote(parts.password) if parts.password else None,
            parts.scheme == SN,
        )

    @property
    def is_loopback(self) -> bool:
        """Whether messages to this address stay on this machine."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def __str__(self) -> str:
        return f"{SN if self.datagrams else 'mqtts' if self.tls else 'mqtt'}://{host_port(self.host, self.port)}"


def address_of(text: str, option: str) -> tuple[str, int]:
    """Host and port of a HOST:PORT to listen at, `[::1]:1883` for IPv6; raises ConfigurationError."""
    host, _, port = text.rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    number = whole_number(port, 65_535)
    if not is_host(bare) or number is None or f"{host}:{port}" != host_port(bare, number):
        raise ConfigurationError(f"{option} {text!r}: expected HOST:PORT, with a port from 1 to 65535")
    return bare, number


def host_port(host: str, port: int) -> str:
    """HOST:PORT, with an IPv6 address in brackets (RFC 3986, 3.2.2)."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_host(text: str) -> bool:
    """Whether a name or an address can be looked up at all: DNS takes labels of 1 to 63 characters."""
    if not text.isprintable() or _NOT_IN_HOSTS.search(text):  # IDNA accepts these
        return False
    try:
        return text.encode("idna") != b""
    except UnicodeError:
        return False


def is_taken(host: str, port: int) -> bool:
    """Whether another program listens at an address."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            return error.errno == errno.EADDRINUSE
        return False


def whole_number(text: str, most: int) -> int | None:
    """Parse a number from 1 to `most` in ASCII digits; None if `text` is not one."""
    if not (text.isascii() and text.isdecimal() and len(text) <= len(str(most))):
        return None
    return int(text) if 1 <= int(text) <= most else None
