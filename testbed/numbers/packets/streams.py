"""One direction of TCP: segments in the order of their sequence numbers, and the frames that carried each byte."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, pairwise

SYN = 0x02


@dataclass(frozen=True)
class Segment:
    """The part of a connection's direction in one frame; `row` is the frame's, `left_ns` is None if it was lost."""

    row: int
    left_ns: int | None
    sequence: int
    syn: bool
    body: bytes


@dataclass
class Run:
    """Bytes of a connection without a gap. Places are offsets in the stream, from the connection's first byte.

    `pieces` are the segments with new bytes, and `begins` the place of each one's first new byte. `copies` are the
    segments that repeated bytes, and `copy_begins` the place of each one's first byte; `longest_copy` is in bytes.
    """

    origin: int
    data: bytearray = field(default_factory=bytearray)
    begins: list[int] = field(default_factory=list)
    pieces: list[Segment] = field(default_factory=list)
    copies: list[Segment] = field(default_factory=list)
    copy_begins: list[int] = field(default_factory=list)
    longest_copy: int = 0
    places: list[tuple[int, Segment]] = field(default_factory=list)

    def add(self, place: int, segment: Segment) -> None:
        """Add the next segment, which begins at or before the end of the run."""
        self.places.append((place, segment))
        fresh = segment.body[self.reached - place :]
        if place < self.reached:
            self.copies.append(segment)
            self.copy_begins.append(place)
            self.longest_copy = max(self.longest_copy, len(segment.body))
        if fresh:
            self.begins.append(self.reached)
            self.pieces.append(segment)
            self.data += fresh

    @property
    def reached(self) -> int:
        return self.origin + len(self.data)

    def row_of(self, place: int) -> int:
        """The frame that first carried a byte, which need not be its piece: a sender may repeat several segments as
        one, which begins in front of the later ones."""
        return min(self._rows_of(place))

    def copies_of(self, place: int) -> int:
        """How many frames carried a byte."""
        return len(self._rows_of(place))

    def _rows_of(self, place: int) -> set[int]:
        piece = self.pieces[bisect_right(self.begins, place) - 1]
        return {segment.row for segment in (piece, *self._copies_with(place, place + 1))}

    def left_ns(self, start: int, end: int) -> int | None:
        """When the bytes from `start` to `end` had left the link, and those of the run before them that did: TCP hands
        on in order. None if one of these bytes never left; of a byte the first copy counts."""
        times = [self._first_ns(low, high) for low, high in pairwise(self._edges(start, end))]
        known = [time for time in times if time is not None]
        if len(known) < len(times):
            return None
        ends, latest_ns = self._handed_on
        before = bisect_right(ends, start)
        return max([*known, *latest_ns[before - 1 : before]], default=0)

    @cached_property
    def _handed_on(self) -> tuple[list[int], list[int]]:
        """Places, and when all bytes before each that ever left had left the link."""
        edges = self._edges(self.origin, self.reached)
        times = [self._first_ns(low, high) or 0 for low, high in pairwise(edges)]
        return edges[1:], list(accumulate(times, max))

    def _first_ns(self, low: int, high: int) -> int | None:
        """When the first of the frames that carried the bytes between two edges had left the link."""
        carriers = [self.pieces[bisect_right(self.begins, low) - 1], *self._copies_with(low, high)]
        return min((one.left_ns for one in carriers if one.left_ns is not None), default=None)

    def _edges(self, start: int, end: int) -> list[int]:
        """The range's ends, and the places between them where the frames that carried a byte change."""
        numbers = range(bisect_left(self.copy_begins, start - self.longest_copy), bisect_left(self.copy_begins, end))
        copies = [(self.copy_begins[n], self.copy_begins[n] + len(self.copies[n].body)) for n in numbers]
        begins = self.begins[bisect_right(self.begins, start) : bisect_left(self.begins, end)]
        within = {place for ends in copies for place in ends if start < place < end}
        return sorted({start, end, *begins, *within})

    def _copies_with(self, start: int, end: int) -> list[Segment]:
        since = bisect_left(self.copy_begins, end - self.longest_copy)
        until = bisect_right(self.copy_begins, start)
        numbers = range(since, until)
        return [self.copies[n] for n in numbers if self.copy_begins[n] + len(self.copies[n].body) >= end]


@dataclass(frozen=True)
class Plain:
    """The content of an unencrypted run, for the reader of packets; `tls.Clear` is that of an encrypted run.

    Offsets count bytes of the content, places count bytes of the stream.
    """

    run: Run

    @property
    def data(self) -> bytearray:
        return self.run.data

    def place(self, offset: int) -> int:
        """The place of a byte in the stream."""
        return self.run.origin + offset

    def needs(self, start: int, end: int) -> tuple[int, int]:
        """The places between which the stream is needed to read these bytes."""
        return self.run.origin + start, self.run.origin + end

    def before(self, place: int) -> int:
        """The number of bytes of content before a place."""
        return place - self.run.origin

    def serves(self, place: int) -> int | None:
        """The offset of the content byte that a place of the stream serves, as a record's header does; else None."""
        return place - self.run.origin

    def resume(self, offset: int) -> int:
        """The offset at which reading goes on after unreadable bytes: the next segment's."""
        following = bisect_right(self.run.begins, self.run.origin + offset)
        return self.run.begins[following] - self.run.origin if following < len(self.run.begins) else len(self.data)


def connections(segments: list[Segment]) -> Iterator[list[Segment]]:
    """Split segments into those of each connection: a SYN begins one."""
    group: list[Segment] = []
    for segment in segments:
        if segment.syn and group:
            yield group
            group = []
        group.append(segment)
    if group:
        yield group


def runs(segments: list[Segment]) -> Iterator[Run]:
    """Order a connection's bytes by their sequence numbers; each gap begins a new run."""
    first = segments[0].sequence + segments[0].syn
    places = [((segment.sequence + segment.syn - first + 2**31) % 2**32) - 2**31 for segment in segments]
    with_body = [(place, segment) for place, segment in zip(places, segments, strict=True) if segment.body]
    run: Run | None = None
    for place, segment in sorted(with_body, key=lambda entry: entry[0]):
        if run is not None and place > run.reached:
            yield run
            run = None
        if run is None:
            run = Run(place)
        run.add(place, segment)
    if run is not None:
        yield run
