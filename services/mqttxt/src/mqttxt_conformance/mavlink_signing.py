"""MAVLink 2's message signing (section 13): the kit's autopilot signs, and looks at what is written to it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

_TICKS_PER_S, _EPOCH_S = 100_000, 1_420_070_400
"""Time stamps count 10 µs since 2015."""
_SIGNED = 1
_SIGNATURE_BYTES, _STAMP_BYTES = 6, 6


def _now() -> int:
    return int((time.time() - _EPOCH_S) * _TICKS_PER_S)


@dataclass
class Signer:
    """A holder of `key` whose time stamps are `late_s` behind the clock."""

    key: bytes
    link_id: int = 1
    late_s: int = 0
    _newest: int = 0

    def equip(self, encoder: Any) -> None:
        """Have an encoder of pymavlink sign its next message."""
        self._newest = max(self._newest + 1, _now() - self.late_s * _TICKS_PER_S)
        encoder.signing.secret_key, encoder.signing.link_id = self.key, self.link_id
        encoder.signing.timestamp, encoder.signing.sign_outgoing = self._newest, True


def signature(message: Any, key: bytes) -> tuple[int, int] | None:
    """The link id and time stamp of a received message; None where `key` has not signed it."""
    frame = bytes(message.get_msgbuf())
    if frame[0] != 0xFD or not frame[2] & _SIGNED:
        return None
    signed, own = frame[:-_SIGNATURE_BYTES], frame[-_SIGNATURE_BYTES:]
    if sha256(key + signed).digest()[:_SIGNATURE_BYTES] != own:
        return None
    return signed[-_STAMP_BYTES - 1], int.from_bytes(signed[-_STAMP_BYTES:], "little")
