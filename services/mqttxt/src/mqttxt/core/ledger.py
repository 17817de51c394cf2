"""The command ledger: the commands that an executor received and its answers to them (docs/protocol.md, R5.3).

Entries live until the deadline has passed, then with their outcomes for ten minutes. A duplicate is recognised,
not executed again; a full ledger denies and never evicts. Stations that are not in control can fill only a share of
it. Hold, land and return find room when nothing else does. No station takes more of a share than it leaves free.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from dataclasses import dataclass
from enum import Enum, auto
from heapq import heappop, heappush
from typing import Generic, TypeVar

from ..protocol.commands import Command, Hold, Land, Return
from ..protocol.messages import CommandId
from .forgotten import Forgotten

KEEP_MS = 600_000
CAPACITY = 8192
FOG_CAPACITY = 65_536
"""The capacity at an activator, whose stations command all drones of its fog."""

Record = TypeVar("Record")


OVERRIDING = (Hold, Land, Return)
"""Commands that bring a drone to a halt, and end the search of a drone for an earlier command."""


class Admission(Enum):
    """The ledger's verdict on an id and its contents.

    IGNORED: the station is not in control, and its share is full. It is not answered at all, because a denial would
    have to be kept: the same id may arrive a second time once its station is in control.
    """

    NEW = auto()
    DUPLICATE = auto()
    CONFLICT = auto()
    FULL = auto()
    IGNORED = auto()


class Share(Enum):
    """The part of the ledger in which a command takes its places."""

    OUTSIDERS = auto()
    ORDINARY = auto()
    OVERRIDING = auto()

    @classmethod
    def of(cls, command: Command, in_control: bool) -> Share:
        """The share of a command; `in_control`: its station controls the drones that the command is for."""
        if not in_control:
            return cls.OUTSIDERS
        return cls.OVERRIDING if isinstance(command, OVERRIDING) else cls.ORDINARY


@dataclass
class Entry(Generic[Record]):
    """One id: its contents (None if known only from a journal), and the record that the ledger's owner keeps of it.

    It takes one of `places` for each executor that may get the command.
    """

    id: CommandId
    contents: Hashable | None
    record: Record
    keep_until_ms: int
    share: Share
    station: Hashable = None
    places: int = 1
    is_open: bool = True


@dataclass(frozen=True)
class _Bar:
    """Commands of `places` or more are denied until `until_ms`."""

    until_ms: int
    places: int


class Ledger(Generic[Record]):
    """Ids with their contents and records, in `capacity` places: a quarter is for outsiders, a sixteenth kept free.

    `station` is the key by which the ledger's owner tells stations apart. Each takes at most half of the places that
    the others of its share have left: one that fills its half leaves the next one a quarter, and so on.
    """

    def __init__(self, capacity: int = CAPACITY, keep_ms: int = KEEP_MS) -> None:
        self._entries: dict[CommandId, Entry[Record]] = {}
        self._capacity = capacity
        self._keep_ms = keep_ms
        self._taken: Counter[Share] = Counter()
        self._taken_by: Counter[tuple[Share, Hashable]] = Counter()
        self._bars: dict[tuple[Share, Hashable], _Bar] = {}
        self._open: dict[CommandId, Entry[Record]] = {}
        self._closed: list[tuple[int, CommandId]] = []
        """A heap of the closed entries, by the time until which each was to be kept when it was closed."""
        self.forgotten = Forgotten(capacity)

    def get(self, command_id: CommandId) -> Entry[Record] | None:
        return self._entries.get(command_id)

    def may_have_forgotten(self, command_id: CommandId) -> bool:
        return self.forgotten.may_have(command_id)

    def entries(self) -> list[Entry[Record]]:
        return list(self._entries.values())

    def open_entries(self) -> list[Entry[Record]]:
        return list(self._open.values())

    def examine(
        self,
        command_id: CommandId,
        contents: Hashable,
        deadline_ms: int,
        now_ms: int,
        share: Share = Share.ORDINARY,
        station: Hashable = None,
        places: int = 1,
    ) -> Admission:
        """Decide on a command of `station` that takes so many places, without entering it.

        After a denial for want of room, unknown ids of the same station and share that take as many places or more
        are denied too, until the deadline of the denied id has passed: it may arrive a second time and must not be
        executed then.
        """
        entry = self._entries.get(command_id)
        if entry is not None:
            same = entry.contents is None or entry.contents == contents
            return Admission.DUPLICATE if same else Admission.CONFLICT
        self._purge(now_ms)
        own, bar = (share, station), self._bars.get((share, station), _Bar(0, places))
        if not self._has_room(share, station, places):
            if share is Share.OUTSIDERS:
                return Admission.IGNORED
            self._bars[own] = _Bar(max(bar.until_ms, deadline_ms + 1), min(bar.places, places))
            return Admission.FULL
        return Admission.FULL if now_ms < bar.until_ms and places >= bar.places else Admission.NEW

    def enter(
        self,
        command_id: CommandId,
        contents: Hashable | None,
        record: Record,
        deadline_ms: int,
        share: Share = Share.ORDINARY,
        station: Hashable = None,
        places: int = 1,
    ) -> Entry[Record]:
        """Enter an id that `examine` called new, or one restored from a journal."""
        entry = Entry(command_id, contents, record, deadline_ms + self._keep_ms, share, station, places)
        self._entries[command_id] = self._open[command_id] = entry
        self._taken[share] += places
        self._taken_by[share, station] += places
        return entry

    def _has_room(self, share: Share, station: Hashable, places: int) -> bool:
        outsiders = self._capacity // 4
        if share is Share.OUTSIDERS:
            free = outsiders - self._taken[share]
        else:
            kept_free = self._capacity // 16 if share is Share.ORDINARY else 0
            taken = self._taken[Share.ORDINARY] + self._taken[Share.OVERRIDING]
            free = self._capacity - outsiders - kept_free - taken
        return self._taken_by[share, station] + places <= free - (places - 1)

    def close(self, entry: Entry[Record], now_ms: int) -> None:
        """The last word is published: keep it for ten minutes from now or from the deadline, whichever is later."""
        entry.is_open = False
        entry.keep_until_ms = max(entry.keep_until_ms, now_ms + self._keep_ms)
        self._open.pop(entry.id, None)
        heappush(self._closed, (entry.keep_until_ms, entry.id))

    def _purge(self, now_ms: int) -> None:
        while self._closed and self._closed[0][0] < now_ms:
            entry = self._entries.get(heappop(self._closed)[1])
            if entry is None or entry.is_open or entry.keep_until_ms >= now_ms:  # closed a second time, or entered
                continue
            del self._entries[entry.id]
            self.forgotten.note(entry.id)
            self._taken[entry.share] -= entry.places
            own = entry.share, entry.station
            self._taken_by[own] -= entry.places
            if self._taken_by[own] == 0:
                del self._taken_by[own]
        self._bars = {own: bar for own, bar in self._bars.items() if now_ms < bar.until_ms}
