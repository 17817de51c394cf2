"""Parses MAVLink frames: each datagram by itself, and a stream with resynchronisation after noise.

pymavlink's own parser trusts a length before it has checked the checksum: two bytes of noise swallow up to 280 that
follow. This parser drops only the first byte of an invalid frame, and searches on from the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

HELD_S = 0.5
"""How long to wait for the rest of a frame: the longest takes 0.05 s at 57,600 baud."""
MOST_SPOILT = 32
"""How many invalid frames a datagram may have before the rest of it is dropped: each costs a checksum."""
NO_FRAME = "mavlink_malformed"
MAGIC = (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)
_V1_BYTES, _V2_BYTES = 8, 12
"""Header and checksum."""
_DECODER = mavlink.MAVLink(None)


@dataclass(frozen=True)
class Malformed:
    """Input that is dropped, and the reason; `kind` is the counter's name."""

    kind: str
    reason: str


def in_datagram(data: bytes) -> Iterator[Any]:
    """The messages and the invalid parts of one datagram, up to `MOST_SPOILT` invalid parts."""
    spoilt = 0
    for found in _in_whole(bytearray(data)):
        yield found
        spoilt += isinstance(found, Malformed)
        if spoilt == MOST_SPOILT:
            return


def _in_whole(rest: bytearray) -> Iterator[Any]:
    while rest:
        yield from _take(rest)
        if rest:
            yield Malformed(NO_FRAME, "a frame that its datagram cuts off")
            del rest[0]


class StreamFrames:
    """The frames of a stream of bytes; `len` is the number of bytes that wait for the rest of a frame."""

    def __init__(self) -> None:
        self._rest = bytearray()
        self._since_s = 0.0

    def __len__(self) -> int:
        return len(self._rest)

    def feed(self, data: bytes, now_s: float) -> Iterator[Any]:
        """The messages that are now complete, and invalid parts."""
        before = len(self._rest)
        self._rest += data
        yield from self._whole(now_s, before)
        while self._rest and now_s - self._since_s > HELD_S:
            yield Malformed(NO_FRAME, "a frame whose rest did not come")
            del self._rest[0]
            yield from self._whole(now_s, 0)

    def _whole(self, now_s: float, before: int) -> Iterator[Any]:
        size = len(self._rest)
        yield from _take(self._rest)
        if before == 0 or len(self._rest) < size:
            self._since_s = now_s


def _take(data: bytearray) -> Iterator[Any]:
    """Take complete frames and noise from the front of `data`; the rest begins with an incomplete frame."""
    while data:
        if data[0] not in MAGIC:
            start = next((at for at, byte in enumerate(data) if byte in MAGIC), len(data))
            yield Malformed(NO_FRAME, f"{start} bytes that begin no frame")
            del data[:start]
            continue
        size = _size(data)
        if size is None or len(data) < size:
            return
        try:
            _check_flags(data)
            message = _DECODER.decode(data[:size])
        except mavlink.MAVError as error:
            yield Malformed(NO_FRAME, str(error))
            del data[0]
            continue
        if isinstance(message, mavlink.MAVLink_unknown) and size < len(data) and data[size] not in MAGIC:
            yield Malformed(NO_FRAME, "bytes behind which no frame begins")  # without its checksum only its end shows
            del data[0]
            continue
        del data[:size]
        if not isinstance(message, mavlink.MAVLink_unknown):
            yield message


def _check_flags(data: bytearray) -> None:
    """Raises MAVError for a frame that needs a newer MAVLink (`incompat_flags`)."""
    if data[0] == mavlink.PROTOCOL_MARKER_V2 and data[2] & ~mavlink.MAVLINK_IFLAG_SIGNED:
        raise mavlink.MAVError(f"invalid incompat_flags 0x{data[2]:02x}")


def _size(data: bytearray) -> int | None:
    """The length in the header of the frame at the front, None before the header is complete."""
    if data[0] == mavlink.PROTOCOL_MARKER_V1:
        return _V1_BYTES + data[1] if len(data) > 1 else None
    if len(data) < 3:
        return None
    signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if data[2] & mavlink.MAVLINK_IFLAG_SIGNED else 0
    return _V2_BYTES + data[1] + signature
