"""The lines of an audit log: chained by hashes, and signed from time to time (docs/protocol.md, section 14)."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Self

import cbor2
from cryptography.exceptions import InvalidSignature

from ..errors import ConfigurationError, PayloadError
from .certificate import Certificate
from .cose import Envelope, external_aad, to_be_signed
from .fleet import Fleet
from .seal import Seal

TOPIC = "audit"
"""Stands for the topic in a signature; no message is published on it."""
BEGINNING = "0" * 64
"""Stands for the hash of the line before the first."""
_LATEST_S = 253_402_300_799
"""The end of the year 9999, the limit of written times: a clock may show any time."""
_LINE = re.compile(rb'(\{"n":([1-9][0-9]{0,17}),.*),"hash":"([0-9a-f]{64})"\}')


@dataclass(frozen=True)
class Link:
    """A line's number in its chain, and its hash."""

    n: int = 0
    hash: str = BEGINNING

    def next(self, time_s: float, event: str, fields: Mapping[str, Any]) -> tuple[Link, bytes]:
        """The next line, at a Unix time, and its link."""
        members = {"n": self.n + 1, "time": _time(time_s), "event": event, **fields}
        body = json.dumps(members, separators=(",", ":"), allow_nan=False).encode()
        link = Link(self.n + 1, _hash(self.hash, body))
        return link, b'%s,"hash":"%s"}\n' % (body[:-1], link.hash.encode())

    def signature(self, seal: Seal) -> str:
        """The signature of this link for a `head`: a COSE_Sign1 with its certificate, in base64."""
        return base64.b64encode(seal.sign(TOPIC, self._payload(), with_certificate=True).encode()).decode()

    def signer(self, signature: object, fleet: Fleet) -> Certificate:
        """The fleet's certificate, valid now or not, that signed this link; raises ValueError if there is none."""
        try:
            envelope = Envelope.parse(base64.b64decode(str(signature), validate=True))
            certificate = Certificate.from_der(envelope.certificate or b"")
        except (ValueError, PayloadError, ConfigurationError) as error:
            raise ValueError("its signature cannot be read") from error
        if fleet.verify(certificate, certificate.not_before_s) == "other_fleet":
            raise ValueError(
                f"it is signed by {certificate.name}, whom the authority of fleet {fleet.name} does not know"
            )
        aad = external_aad(fleet.key_hash, certificate.name, TOPIC)
        try:
            certificate.public_key.verify(envelope.signature, to_be_signed(envelope.payload, aad))
        except InvalidSignature:
            raise ValueError(f"its signature is not that of {certificate.name}") from None
        if envelope.payload != self._payload():
            raise ValueError(f"{certificate.name} has signed another line")
        return certificate

    def _payload(self) -> bytes:
        return cbor2.dumps([self.n, bytes.fromhex(self.hash)], canonical=True)


@dataclass(frozen=True)
class Line:
    """A line of a file: its own number and hash, its fields, and the bytes that are hashed."""

    link: Link
    fields: dict[str, Any]
    body: bytes

    @classmethod
    def parse(cls, line: bytes) -> Self:
        """Parse a line; raises ValueError if it is not an audit log's. The hash is not verified."""
        found = _LINE.fullmatch(line)
        if found is None:
            raise ValueError("it cannot be read")
        body = found[1] + b"}"
        try:
            fields = json.loads(body)
        except (ValueError, RecursionError) as error:
            raise ValueError("it cannot be read") from error
        if not (isinstance(fields.get("time"), str) and isinstance(fields.get("event"), str)):
            raise ValueError("it has no time and event")
        return cls(Link(int(found[2]), found[3].decode()), fields, body)

    def follows(self, before: Link) -> bool:
        """Whether this line follows that one, unchanged."""
        return self.link == Link(before.n + 1, _hash(before.hash, self.body))


def _hash(before: str, body: bytes) -> str:
    return hashlib.sha256(before.encode() + body).hexdigest()


def _time(time_s: float) -> str:
    return datetime.fromtimestamp(min(time_s, _LATEST_S), UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
