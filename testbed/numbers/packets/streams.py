"""What TCP carries in one direction: segments put in the order of their sequence numbers, and what carried a byte."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field

SYN = 0x02


@dataclass(frozen=True)
class Segment:
    """What one frame carries of a direction of a connection; `row` names it, `left_ns` is None for a lost one."""

    row: int
    left_ns: int | None
    sequence: int
    syn: bool
    body: bytes


@dataclass
class Run:
    """Bytes of a connection without a gap. Places are those of the stream, counted from the connection's first byte.

    `pieces` are the segments that gave bytes, and `begins` the places from which on each did; `copies` are those that
    brought bytes again, and `copy_begins` the places of their first ones; `longest_copy` is in bytes.
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
        """Take in the next segment, which begins at or before the end of what is there."""
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
        """The frame that first carried a byte."""
        return self.pieces[bisect_right(self.begins, place) - 1].row

    def copies_of(self, place: int) -> int:
        """How many frames carried a byte."""
        return 1 + len(self._copies_with(place, place + 1))

    def left_ns(self, start: int, end: int) -> int | None:
        """When the first copy of each byte had left the link; None where one never did."""
        latest = 0
        for number in range(bisect_right(self.begins, start) - 1, bisect_left(self.begins, end)):
            low = max(start, self.begins[number])
            high = min(end, self.begins[number + 1] if number + 1 < len(self.begins) else end)
            carriers = [self.pieces[number], *self._copies_with(low, high)]
            times = [carrier.left_ns for carrier in carriers if carrier.left_ns is not None]
            if not times:
                return None
            latest = max(latest, min(times))
        return latest

    def _copies_with(self, start: int, end: int) -> list[Segment]:
        since = bisect_left(self.copy_begins, end - self.longest_copy)
        until = bisect_right(self.copy_begins, start)
        numbers = range(since, until)
        return [self.copies[n] for n in numbers if self.copy_begins[n] + len(self.copies[n].body) >= end]


@dataclass(frozen=True)
class Plain:
    """What a run says to who reads it: its bytes as they are. `tls.Clear` is the same of an encrypted one.

    Offsets count the bytes that are read, places those of the stream.
    """

    run: Run

    @property
    def data(self) -> bytearray:
        return self.run.data

    def place(self, offset: int) -> int:
        """Where in the stream a byte is."""
        return self.run.origin + offset

    def needs(self, start: int, end: int) -> tuple[int, int]:
        """From where to where the stream has to be there, for these bytes to be read."""
        return self.run.origin + start, self.run.origin + end

    def before(self, place: int) -> int:
        """How many bytes that are read come before a place."""
        return place - self.run.origin

    def serves(self, place: int) -> int | None:
        """The offset of the byte for which a place of the stream is there; None for what is of no use to a reader."""
        return place - self.run.origin

    def resume(self, offset: int) -> int:
        """Where to go on behind bytes that are nothing: at the next segment."""
        following = bisect_right(self.run.begins, self.run.origin + offset)
        return self.run.begins[following] - self.run.origin if following < len(self.run.begins) else len(self.data)


def connections(segments: list[Segment]) -> Iterator[list[Segment]]:
    """The segments of each connection: a SYN begins one."""
    group: list[Segment] = []
    for segment in segments:
        if segment.syn and group:
            yield group
            group = []
        group.append(segment)
    if group:
        yield group


def runs(segments: list[Segment]) -> Iterator[Run]:
    """The bytes of a connection, in the order of their sequence numbers; a new run after each gap."""
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
