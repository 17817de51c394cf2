"""MAVLink 2's message signing as autopilots do it: one key and one table of streams for all links; no I/O."""

from __future__ import annotations

import hashlib
from collections.abc import Set
from pathlib import Path
from typing import Any, Final

from pymavlink.dialects.v20 import development as mavlink

from .errors import SitlError

KEY_BYTES: Final = 32
MOST_STREAMS: Final = 16
"""The limit of MAVLink's C library: a further stream is ignored until the autopilot restarts."""
OLDEST_START: Final = 60 * 100_000
"""How far behind the autopilot's own time a new stream may begin, in units of 10 microseconds."""

Stream = tuple[int, int, int]


def read_key(path: Path) -> bytes:
    """Read a key from a file of hexadecimal digits. Raises SitlError."""
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except OSError as error:
        raise SitlError(f"--mavlink-key {path}: {error.strerror}") from error
    except ValueError as error:
        raise SitlError(f"--mavlink-key {path}: expected {2 * KEY_BYTES} hexadecimal digits") from error
    if len(key) != KEY_BYTES:
        raise SitlError(f"--mavlink-key {path}: {len(key)} bytes; expected {KEY_BYTES}")
    return key


class Codec(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """One link's codec. pymavlink stores a timestamp before it checks the signature; the C library does not."""

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:
        """Whether a message is signed with the key, and newer than the last one of its stream."""
        signing, streams = self.signing, self.signing.stream_timestamps
        assert signing.secret_key is not None
        if hashlib.sha256(signing.secret_key + msgbuf[:-6]).digest()[:6] != msgbuf[-6:]:
            return False
        stamp, stream = int.from_bytes(msgbuf[-12:-6], "little"), (msgbuf[-13], srcSystem, srcComponent)
        if stream in streams:
            if stamp <= streams[stream]:
                return False
        elif len(streams) >= MOST_STREAMS or stamp + OLDEST_START < signing.timestamp:
            return False
        streams[stream] = stamp
        signing.timestamp = max(signing.timestamp, stamp)
        return True


class Signing:
    """An autopilot's key, if it has one, and the codecs of its links.

    Its time begins at the key's, as on an autopilot without a clock: others' messages bring it forward. `unsigned` are
    the messages that it accepts without a signature, too.
    """

    def __init__(self, system_id: int, unsigned: Set[int], key: bytes | None = None) -> None:
        self._system_id = system_id
        self._unsigned = unsigned
        self._streams: dict[Stream, int] = {}
        self._codecs: list[Codec] = []
        self._key = key

    def codec(self) -> Codec:
        """Make the codec of one more link."""
        made = Codec(None, srcSystem=self._system_id, srcComponent=1)
        made.robust_parsing = True
        made.signing.link_id = len(self._codecs)
        made.signing.stream_timestamps = self._streams
        made.signing.allow_unsigned_callback = lambda _, number: number in self._unsigned
        self._codecs.append(made)
        self._equip(made, 0)
        return made

    def set_up(self, message: Any) -> None:
        """Take the key of a SETUP_SIGNING; a key and a timestamp of zeros end signing."""
        key = bytes(message.secret_key)
        self._key = key if any(key) or message.initial_timestamp else None
        for codec in self._codecs:
            self._equip(codec, message.initial_timestamp)

    def _equip(self, codec: Codec, stamp: int) -> None:
        codec.signing.secret_key, codec.signing.timestamp = self._key, stamp
        codec.signing.sign_outgoing = self._key is not None
