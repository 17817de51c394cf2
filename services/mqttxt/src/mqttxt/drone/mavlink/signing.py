"""MAVLink 2's message signing between UAV client and autopilot (docs/protocol.md, section 13).

pymavlink signs the written messages. Received ones are judged here: pymavlink stores a message's time stamp before it
checks the signature, so that one forged message would silence the autopilot.
"""

from __future__ import annotations

import hashlib
import hmac
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ...errors import ConfigurationError
from ...security import files
from .frame_parser import Malformed
from .stamps import TICKS_PER_S, Stamps
from .vehicle import HEARTBEAT_LOST_MS

LINK_ID: Final = 191
"""The link id of all that a UAV client signs. It never changes, because autopilots keep 16 streams until a restart."""
KEY_BYTES: Final = 32
_OLDEST_START: Final = 60 * TICKS_PER_S
_SIGNATURE_BYTES, _STAMP_BYTES = 6, 6
_NOT_ONE: Final = "expected 64 hexadecimal digits (`mqttxt keys mavlink` makes such a file)"


@dataclass(frozen=True)
class NotTrusted(Malformed):
    """A message that is not trusted. `is_stale`: only its time stamp is wrong, so the sender has the key."""

    message: Any = None
    is_stale: bool = False


def read_key(path: Path) -> bytes:
    """The key in a file of hexadecimal digits that only its owner can read. Raises ConfigurationError."""
    text = files.read(path, private=True).strip()
    try:
        key = bytes.fromhex(text.decode("ascii"))
    except ValueError as error:
        raise ConfigurationError(f"{path}: {_NOT_ONE}") from error
    if len(key) != KEY_BYTES:
        raise ConfigurationError(f"{path}: {len(key)} bytes; {_NOT_ONE}")
    if not any(key):
        raise ConfigurationError(f"{path}: all zeros, which switches signing off at an autopilot; {_NOT_ONE}")
    return key


def is_signed(message: Any) -> bool:
    """Whether a received message has a signature, with any key."""
    frame = message.get_msgbuf()
    return bool(frame[0] == mavlink.PROTOCOL_MARKER_V2 and frame[2] & mavlink.MAVLINK_IFLAG_SIGNED)


class Signing:
    """A key on one link, for both directions: the newest time stamp received of each stream, and those to send."""

    def __init__(self, key: bytes, stamps: Stamps) -> None:
        self.stamps = stamps
        self._key = key
        self._newest: dict[tuple[int, int, int], int] = {}
        """The newest time stamps by system, component and link id."""
        self._coming: dict[tuple[int, int], tuple[int, float]] = {}
        """The current link id of each system and component, and the time of its last message, s."""

    @classmethod
    def load(cls, key: Path, journal: Path) -> Signing:
        """Load the key from a file, and the time stamps from beside the journal. Raises ConfigurationError."""
        return cls(read_key(key), Stamps(journal.with_name(f"{journal.name}.mavlink-time")))

    def equip(self, encoder: mavlink.MAVLink) -> None:
        """Make a pymavlink encoder sign; call `stamp` before each message."""
        encoder.signing.secret_key, encoder.signing.link_id = self._key, LINK_ID
        encoder.signing.sign_outgoing = True

    def stamp(self, encoder: mavlink.MAVLink) -> bool:
        """Give the next message its time stamp; False if none is left."""
        stamp = self.stamps.next()
        if stamp is not None:
            encoder.signing.timestamp = stamp
        return stamp is not None

    def judge(self, message: Any, now_s: float) -> Any:
        """The message, or NotTrusted with the reason."""
        if not is_signed(message):
            return NotTrusted("mavlink_unsigned", f"a {message.get_type()} without a signature", message)
        frame = bytes(message.get_msgbuf())
        computed = hashlib.sha256(self._key + frame[:-_SIGNATURE_BYTES]).digest()[:_SIGNATURE_BYTES]
        if not hmac.compare_digest(computed, frame[-_SIGNATURE_BYTES:]):
            return NotTrusted("mavlink_other_key", f"a {message.get_type()} that is signed with another key", message)
        return self._in_time(message, frame[:-_SIGNATURE_BYTES], now_s)

    def _in_time(self, message: Any, signed: bytes, now_s: float) -> Any:
        """The correctly signed message, or NotTrusted if it is old or from another than the current link."""
        stamp, link_id = int.from_bytes(signed[-_STAMP_BYTES:], "little"), signed[-_STAMP_BYTES - 1]
        source = message.get_srcSystem(), message.get_srcComponent()
        newest = self._newest.get((*source, link_id))
        if (newest is None and stamp + _OLDEST_START < self.stamps.now()) or (newest is not None and stamp <= newest):
            return NotTrusted("mavlink_old", f"a {message.get_type()} whose time stamp is old", message, is_stale=True)
        coming, came_s = self._coming.get(source, (link_id, now_s))
        if coming != link_id and now_s - came_s <= HEARTBEAT_LOST_MS / 1000:
            return NotTrusted("mavlink_other_link", f"a {message.get_type()} that was signed for another link", message)
        self._newest[(*source, link_id)] = stamp
        self._coming[source] = link_id, now_s
        self.stamps.adopt(stamp)
        return message
