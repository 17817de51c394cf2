"""TLS 1.3 records of a capture, decrypted with the session keys that the nodes logged (RFC 8446, RFC 9850)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand

from .streams import Run

Secrets = Mapping[str, bytes]
"""The traffic secrets of a session, by their labels in a key log."""
_SIDES = ("CLIENT", "SERVER")
_HANDSHAKE, _APPLICATION = 22, 23
_HEADER, _NONCE = 5, 12
_HELLO, _RANDOM = b"\x01", slice(11, 43)
"""A ClientHello's message type, and the position of its random in a record that begins with one."""


def read_key_log(path: Path) -> dict[bytes, dict[str, bytes]]:
    """The secrets of each session by its client random; empty without a file. Lines of any other form are skipped."""
    found: dict[bytes, dict[str, bytes]] = {}
    for line in path.read_text(encoding="ascii", errors="replace").splitlines() if path.exists() else ():
        words = line.split()
        try:
            label, random, secret = words[0], bytes.fromhex(words[1]), bytes.fromhex(words[2])
        except (IndexError, ValueError):
            continue
        found.setdefault(random, {})[label] = secret
    return found


def client_random(data: bytes) -> bytes | None:
    """The client random, which identifies the session, of a stream that begins with a ClientHello; else None."""
    is_hello = data[:1] == bytes([_HANDSHAKE]) and data[_HEADER : _HEADER + 1] == _HELLO
    return data[_RANDOM] if is_hello and len(data) >= _RANDOM.stop else None


@dataclass(frozen=True)
class Record:
    """A record with application data: its start and end in the stream, and its data's place and offset."""

    start: int
    end: int
    data_place: int
    offset: int
    length: int


@dataclass
class Clear:
    """The content of an encrypted run, as `streams.Plain`; places count bytes of the encrypted stream.

    A message can be read once the whole record with its last byte has arrived. `is_unread`: the keys do not open all
    records.
    """

    data: bytearray = field(default_factory=bytearray)
    records: list[Record] = field(default_factory=list)
    is_unread: bool = False

    @classmethod
    def of(cls, run: Run, sessions: Sequence[Secrets]) -> Clear:
        """Decrypt a run that begins with its connection, by whichever of the sessions' secrets open it."""
        found = cls(is_unread=run.data[0] != _HANDSHAKE)
        keys: _Keys | None = None
        for start, end in _records(run.data):
            if run.data[start] != _APPLICATION:
                continue
            record = bytes(run.data[start:end])
            keys = keys or _keys_of(record, sessions)
            inner = keys.open(record) if keys is not None else None
            if inner is None:
                found.is_unread = True
                break
            body = inner.rstrip(b"\0")
            if body[-1:] == bytes([_APPLICATION]) and len(body) > 1:
                place = run.origin + start
                found.records.append(Record(place, run.origin + end, place + _HEADER, len(found.data), len(body) - 1))
                found.data += body[:-1]
        return found

    def place(self, offset: int) -> int:
        record = self._with(offset)
        return record.data_place + offset - record.offset

    def needs(self, start: int, end: int) -> tuple[int, int]:
        return self._with(start).start, self._with(end - 1).end

    def before(self, place: int) -> int:
        number = bisect_right(self.records, place, key=lambda record: record.start) - 1
        if number < 0:
            return 0
        record = self.records[number]
        return record.offset + min(max(0, place - record.data_place), record.length)

    def serves(self, place: int) -> int | None:
        number = bisect_right(self.records, place, key=lambda record: record.start) - 1
        if number < 0 or place >= self.records[number].end:
            return None
        record = self.records[number]
        return min(self.before(place), record.offset + record.length - 1)

    def resume(self, offset: int) -> int:
        """The offset at which reading goes on after unreadable bytes: the next record's."""
        record = self._with(offset)
        return record.offset + record.length

    def _with(self, offset: int) -> Record:
        return self.records[bisect_right(self.records, offset, key=lambda record: record.offset) - 1]


class _Keys:
    """Decrypts the records of one direction, in order: first the handshake's, then the application's."""

    def __init__(self, secrets: Secrets, side: str) -> None:
        self._next = [secrets[label] for label in (f"{side}_TRAFFIC_SECRET_0",) if label in secrets]
        self._use(secrets[f"{side}_HANDSHAKE_TRAFFIC_SECRET"])

    def open(self, record: bytes) -> bytes | None:
        """Decrypt the next record, with the current keys or those that follow; None if neither open it."""
        opened = self._open(record)
        if opened is None and self._next:
            self._use(self._next.pop())
            self._next.append(_expanded(self._secret, "traffic upd", len(self._secret)))
            opened = self._open(record)
        return opened

    def _use(self, secret: bytes) -> None:
        self._secret = secret
        self._cipher = AESGCM(_expanded(secret, "key", 32 if len(secret) == hashes.SHA384.digest_size else 16))
        self._vector = int.from_bytes(_expanded(secret, "iv", _NONCE), "big")
        self._sequence = 0

    def _open(self, record: bytes) -> bytes | None:
        nonce = (self._vector ^ self._sequence).to_bytes(_NONCE, "big")
        try:
            opened = self._cipher.decrypt(nonce, record[_HEADER:], record[:_HEADER])
        except InvalidTag:
            return None
        self._sequence += 1
        return opened


def _keys_of(record: bytes, sessions: Sequence[Secrets]) -> _Keys | None:
    """The keys that open a direction's first encrypted record, found by trying those of all sessions and sides.

    Only AES-GCM, which OpenSSL's defaults agree upon.
    """
    for secrets in sessions:
        for side in _SIDES:
            if f"{side}_HANDSHAKE_TRAFFIC_SECRET" in secrets and _Keys(secrets, side).open(record) is not None:
                return _Keys(secrets, side)
    return None


def _records(data: bytearray) -> Iterator[tuple[int, int]]:
    """Start and end of each complete record."""
    at = 0
    while at + _HEADER <= len(data):
        end = at + _HEADER + int.from_bytes(data[at + 3 : at + 5], "big")
        if end > len(data):
            return
        yield at, end
        at = end


def _expanded(secret: bytes, label: str, length: int) -> bytes:
    """HKDF-Expand-Label (RFC 8446, 7.1) without a context."""
    name = b"tls13 " + label.encode()
    info = length.to_bytes(2, "big") + bytes([len(name)]) + name + b"\0"
    algorithm = hashes.SHA384() if len(secret) == hashes.SHA384.digest_size else hashes.SHA256()
    return HKDFExpand(algorithm, length, info).derive(secret)
