"""TCP's retransmissions by the captures at both ends of a link: which frames repeated bytes, and which needlessly."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

from .streams import Segment, connections

NEEDED, NEEDLESS = "needed", "needless"
"""A repetition of bytes that a link had lost, and a repetition of bytes that had arrived."""


def retransmissions(segments: list[Segment]) -> dict[int, str]:
    """The kind of each frame of one direction between two ports that repeated bytes or a SYN, by its row.

    The segments are in the order in which they entered the link; in it a sender's sequence numbers fall only when it
    repeats. A repetition is needless if each of its bytes was in an earlier frame that left the link.
    """
    found: dict[int, str] = {}
    opening: Segment | None = None
    for group in connections(segments):
        first = group[0]
        if first.syn:
            if opening is not None and opening.sequence == first.sequence:
                found[first.row] = NEEDED if opening.left_ns is None else NEEDLESS
            opening = first
        found |= _in_connection(group)
    return found


def _in_connection(group: list[Segment]) -> dict[int, str]:
    found: dict[int, str] = {}
    start = group[0].sequence + group[0].syn
    sent, delivered = None, _Ranges()
    for segment in group:
        if not segment.body:
            continue
        place = ((segment.sequence + segment.syn - start + 2**31) % 2**32) - 2**31
        end = place + len(segment.body)
        if sent is not None and place < sent:
            found[segment.row] = NEEDLESS if delivered.hold(place, min(end, sent)) else NEEDED
        sent = end if sent is None else max(sent, end)
        if segment.left_ns is not None:
            delivered.add(place, end)
    return found


class _Ranges:
    """Ranges of places, joined where they touch."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []

    def add(self, start: int, end: int) -> None:
        low, high = bisect_left(self._ends, start), bisect_right(self._starts, end)
        if low < high:
            start, end = min(start, self._starts[low]), max(end, self._ends[high - 1])
        self._starts[low:high], self._ends[low:high] = [start], [end]

    def hold(self, start: int, end: int) -> bool:
        """Whether a single range covers all of `start` to `end`."""
        at = bisect_right(self._starts, start) - 1
        return at >= 0 and self._ends[at] >= end
