"""The command ledger: what an executor has been asked and what it answered (docs/protocol.md, section 5).

Entries live until the deadline has passed, then with their outcomes for ten minutes. A duplicate is found,
not executed again; a full ledger denies and never evicts.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from enum import Enum, auto
from math import inf
from typing import Generic, TypeVar

from ..messages import CommandId

KEEP_MS = 600_000
CAPACITY = 4096

Record = TypeVar("Record")


class Admission(Enum):
    """What the ledger says of an id and its contents."""

    NEW = auto()
    DUPLICATE = auto()
    CONFLICT = auto()
    FULL = auto()


@dataclass
class Entry(Generic[Record]):
    """One id: its contents (None when known only from a journal), and what its owner records about it."""

    id: CommandId
    contents: Hashable | None
    record: Record
    keep_until_ms: int
    is_open: bool = True


class Ledger(Generic[Record]):
    """Ids with their contents and records, bounded by `capacity`."""

    def __init__(self, capacity: int = CAPACITY, keep_ms: int = KEEP_MS) -> None:
        self._entries: dict[CommandId, Entry[Record]] = {}
        self._capacity = capacity
        self._keep_ms = keep_ms
        self._barred_until_ms = -1
        self._open: dict[CommandId, Entry[Record]] = {}
        self._purge_after_ms: float = inf
        """No closed entry is to go before this; with ten minutes of entries each look at all of them counts."""

    def get(self, command_id: CommandId) -> Entry[Record] | None:
        return self._entries.get(command_id)

    def entries(self) -> list[Entry[Record]]:
        return list(self._entries.values())

    def open_entries(self) -> list[Entry[Record]]:
        return list(self._open.values())

    def examine(self, command_id: CommandId, contents: Hashable, deadline_ms: int, now_ms: int) -> Admission:
        """What to do with a command, without entering it.

        While the deadline of an id that was denied for want of room has not passed, unknown ids are denied
        too: the denied one may arrive a second time and must not be executed then.
        """
        entry = self._entries.get(command_id)
        if entry is not None:
            same = entry.contents is None or entry.contents == contents
            return Admission.DUPLICATE if same else Admission.CONFLICT
        self._purge(now_ms)
        if len(self._entries) >= self._capacity:
            self._barred_until_ms = max(self._barred_until_ms, deadline_ms)
            return Admission.FULL
        return Admission.FULL if now_ms <= self._barred_until_ms else Admission.NEW

    def enter(
        self, command_id: CommandId, contents: Hashable | None, record: Record, deadline_ms: int
    ) -> Entry[Record]:
        """Enter an id that `examine` called new, or one restored from a journal."""
        entry = Entry(command_id, contents, record, deadline_ms + self._keep_ms)
        self._entries[command_id] = self._open[command_id] = entry
        return entry

    def close(self, entry: Entry[Record], now_ms: int) -> None:
        """The last word is said: keep it for ten minutes from now or from the deadline, whichever is later."""
        entry.is_open = False
        entry.keep_until_ms = max(entry.keep_until_ms, now_ms + self._keep_ms)
        self._open.pop(entry.id, None)
        self._purge_after_ms = min(self._purge_after_ms, entry.keep_until_ms)

    def _purge(self, now_ms: int) -> None:
        if now_ms <= self._purge_after_ms:
            return
        closed = [entry for entry in self._entries.values() if not entry.is_open]
        for entry in closed:
            if now_ms > entry.keep_until_ms:
                del self._entries[entry.id]
        self._purge_after_ms = min((e.keep_until_ms for e in closed if now_ms <= e.keep_until_ms), default=inf)
