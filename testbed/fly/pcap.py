"""A capture file as arrays: the position, time and length of each frame."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import ResultsError

Bytes = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
Words = npt.NDArray[np.uint64]

PADDING = 512
"""Zeros after the file's last byte, so that a header can be read at any position in it."""
_FILE_HEADER, _RECORD_HEADER = 24, 16
_MAGIC = {
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
}
"""By a file's first bytes its byte order, and its time resolution in nanoseconds (pcap-savefile(5))."""
_ETHERNET = 1


@dataclass(frozen=True)
class CapturedFrames:
    """The frames of one file, in its order.

    `data` is the whole file; frame i is `data[starts[i]:starts[i] + lengths[i]]`. `sizes` are the bytes on the wire
    without the FCS, `t_ns` nanoseconds since the epoch. `truncated`: the file ends within a frame.
    """

    data: Bytes
    starts: Ints
    lengths: Ints
    sizes: Ints
    t_ns: Ints
    truncated: bool


def read_capture(path: Path) -> CapturedFrames:
    """Read the frames of a pcap, up to the cut if it was cut off. Raises ResultsError if it is no Ethernet pcap."""
    try:
        size = path.stat().st_size
        data = np.zeros(size + PADDING, dtype=np.uint8)
        with path.open("rb") as file:
            size = file.readinto(data.data[:size])
    except OSError as error:
        raise ResultsError(f"{path}: not a capture: {error.strerror}") from error
    if size == 0:  # as a full disk leaves it
        return _arranged(data, np.empty(0, dtype=np.int64), "<", 1, True)
    magic = _MAGIC.get(bytes(data[:4]))
    if magic is None:
        raise ResultsError(f"{path}: not a capture: it begins with {bytes(data[: min(4, size)])!r}")
    order, step_ns = magic
    link_type = struct.unpack_from(f"{order}I", data.data, 20)[0]
    if size >= _FILE_HEADER and link_type & 0xFFFF != _ETHERNET:
        raise ResultsError(f"{path}: link type is {link_type}, expected {_ETHERNET} (Ethernet)")
    starts, end = _record_starts(data.data, size, order)
    return _arranged(data, starts, order, step_ns, end != size)


class CaptureTail:
    """A capture that is still being written; each read goes on where the last one ended.

    Parameters:
        path: the file, which need not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._at = _FILE_HEADER

    def more(self) -> CapturedFrames:
        """The complete frames written since the last call. Raises ResultsError if the file is no pcap."""
        try:
            with self._path.open("rb") as file:
                head = file.read(_FILE_HEADER)
                file.seek(self._at)
                rest = file.read()
        except OSError:
            return empty_capture()
        if len(head) < _FILE_HEADER:
            return empty_capture()
        if head[:4] not in _MAGIC:
            raise ResultsError(f"{self._path}: not a capture: it begins with {head[:4]!r}")
        order, step_ns = _MAGIC[head[:4]]
        size = _FILE_HEADER + len(rest)
        data = np.zeros(size + PADDING, dtype=np.uint8)
        data[:size] = np.frombuffer(head + rest, dtype=np.uint8)
        starts, end = _record_starts(data.data, size, order)
        self._at += end - _FILE_HEADER
        return _arranged(data, starts, order, step_ns, end != size)


def empty_capture() -> CapturedFrames:
    """A capture without a frame."""
    return _arranged(np.zeros(PADDING, dtype=np.uint8), np.empty(0, dtype=np.int64), "<", 1, False)


def windows(data: Bytes, width: int, at: Ints) -> Bytes:
    """The `width` bytes of `data` from each position on, as an array of shape (positions, width)."""
    found: Bytes = np.lib.stride_tricks.sliding_window_view(data, width)[at]
    return found


def big_endian(rows: Bytes, start: int, width: int) -> Ints:
    """The numbers in network byte order in the `width` columns from `start` on."""
    value = rows[:, start].astype(np.int64)
    for column in range(start + 1, start + width):
        value = value << 8 | rows[:, column]
    return value


def _record_starts(data: memoryview, size: int, order: str) -> tuple[Ints, int]:
    """The start of each frame, and the end of the last complete one. It loops, as only a record leads to the next."""
    length_at = struct.Struct(f"{order}8xI").unpack_from
    starts = []
    at = _FILE_HEADER
    while at + _RECORD_HEADER <= size:
        following = at + _RECORD_HEADER + length_at(data, at)[0]
        if following > size:
            break
        starts.append(at + _RECORD_HEADER)
        at = following
    return np.array(starts, dtype=np.int64), at


def _arranged(data: Bytes, starts: Ints, order: str, step_ns: int, truncated: bool) -> CapturedFrames:
    heads = windows(data, _RECORD_HEADER, starts - _RECORD_HEADER)
    fields = np.ascontiguousarray(heads).view(f"{order}u4").astype(np.int64).reshape(-1, 4)
    t_ns = fields[:, 0] * 1_000_000_000 + fields[:, 1] * step_ns
    return CapturedFrames(data, starts, fields[:, 2], fields[:, 3], t_ns, truncated)
