"""The journal's front has a command while the disk takes its time, and a client that was killed finds it there."""

from __future__ import annotations

import asyncio
import errno
import os
import shutil
import threading
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from mqttxt.drone import journal as journals
from mqttxt.drone import journal_front
from mqttxt.drone.answers import Unfinished
from mqttxt.drone.effects import Journal
from mqttxt.drone.journal import JournalFile
from mqttxt.drone.journal_keeper import JournalKeeper
from mqttxt.protocol.messages import CommandId, Word
from tests.rigs.processes import eventually
from tests.unit.mqttxt.test_journal import make_whole, started


class Disk:
    """What stands in for `os` in the journal: a sync waits from `stall` to `go_on`, and fails while it `is_full`."""

    def __init__(self) -> None:
        self._goes_on = threading.Event()
        self._goes_on.set()
        self.is_full = False

    def __getattr__(self, name: str) -> object:
        return getattr(os, name)

    def stall(self) -> None:
        self._goes_on.clear()

    def go_on(self) -> None:
        self._goes_on.set()

    def fsync(self, file: int) -> None:
        self._goes_on.wait()
        if self.is_full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(file)


class Client:
    """A keeper, and what it says."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.opened: list[tuple[int, bool]] = []
        self.errors: list[str] = []
        self.journal = JournalFile(make_whole(path), with_front=True)
        self.front = self.journal.front
        self._keeper = JournalKeeper(
            self.journal,
            lambda command_id, is_journalled: self.opened.append((command_id.seq, is_journalled)),
            lambda error: self.errors.append(error.strerror),
        )

    def begin(self, seq: int, command: str = "takeoff") -> None:
        if self._keeper.record(Journal(CommandId(1, seq), command)):
            self.opened.append((seq, True))

    def end(self, seq: int, command: str = "takeoff") -> None:
        self._keeper.record(Journal(CommandId(1, seq), command, Word.COMPLETED))

    @property
    def front_size(self) -> int:
        assert self.front is not None
        return (journal_front.FOLDER / self.front.name).stat().st_size

    def copy(self, tmp_path: Path) -> Path:
        """What a client that is killed here and now leaves on the disk."""
        return Path(shutil.copy(self.path, tmp_path / "left"))

    async def close(self) -> None:
        await self._keeper.close()


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    disk = Disk()
    monkeypatch.setattr(journals, "os", disk)
    yield disk
    disk.go_on()


@pytest.fixture(autouse=True)
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "memory"
    folder.mkdir()
    monkeypatch.setattr(journal_front, "FOLDER", folder)
    return folder


@pytest.fixture
async def client(tmp_path: Path, disk: Disk, memory: Path) -> AsyncIterator[Client]:
    client = Client(tmp_path / "journal")
    yield client
    disk.go_on()
    await client.close()


async def test_the_disk_is_asked_behind_what_follows_in_the_same_turn(client: Client, disk: Disk) -> None:
    before = set(threading.enumerate())
    client.begin(1)
    assert set(threading.enumerate()) == before
    await eventually(lambda: set(threading.enumerate()) != before, "the journal's thread")
    await eventually(lambda: client.front_size == 0, "the disk has it")


async def test_what_is_recorded_in_the_turn_of_the_end_is_on_the_disk(client: Client, tmp_path: Path) -> None:
    client.begin(1)
    await client.close()
    assert [left.id.seq for left in started(client.copy(tmp_path)).unfinished] == [1]


async def test_a_disk_that_stalls_delays_neither_a_command_nor_the_event_loop(client: Client, disk: Disk) -> None:
    disk.stall()
    client.begin(1)
    client.begin(2, "hold")
    client.end(2, "hold")
    assert client.opened == [(1, True), (2, True)]
    assert client.front_size > 0
    disk.go_on()
    await eventually(lambda: client.front_size == 0, "the disk has all of it")
    assert [left.id.seq for left in client.journal.unfinished] == [1, 2]


async def test_a_client_that_is_killed_while_the_disk_stalls_knows_what_it_had_begun(
    client: Client, disk: Disk, tmp_path: Path
) -> None:
    client.begin(1)
    await eventually(lambda: client.front_size == 0, "the disk has the first")
    disk.stall()
    client.begin(2, "hold")
    client.end(1)
    left_behind = client.copy(tmp_path)
    assert "completed" not in left_behind.read_text(), "the disk does not have it"
    disk.go_on()
    left = started(left_behind, with_front=True)
    assert sorted(left.unfinished, key=lambda one: one.id.seq) == [
        Unfinished(CommandId(1, 1), "takeoff", Word.COMPLETED),
        Unfinished(CommandId(1, 2), "hold"),
    ]
    assert not left.has_gap


@pytest.mark.parametrize("how", ["gone", "of another boot", "a link", "not readable"])
async def test_without_its_front_a_killed_client_cannot_say_that_a_command_was_not_begun(
    client: Client, memory: Path, tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    client.begin(1)
    await eventually(lambda: client.front_size == 0, "the disk has it")
    (front,) = memory.iterdir()
    if how == "gone":
        front.unlink()
    elif how == "a link":
        front.rename(tmp_path / "elsewhere")
        front.symlink_to(tmp_path / "elsewhere")
    elif how == "not readable":
        front.write_bytes(b"{}\n{}\n")
    else:
        (tmp_path / "boot_id").write_text(f"{'0' * 8}-0000-0000-0000-{'0' * 12}\n")
        monkeypatch.setattr(journal_front, "_BOOT_ID", tmp_path / "boot_id")
    left = started(client.copy(tmp_path), with_front=True)
    assert [one.id.seq for one in left.unfinished] == [1]
    assert left.has_gap


async def test_a_client_that_ends_leaves_no_front_and_no_gap(tmp_path: Path, memory: Path) -> None:
    client = Client(tmp_path / "journal")
    client.begin(1)
    await client.close()
    assert list(memory.iterdir()) == []
    left = started(client.path, with_front=True)
    assert [one.id.seq for one in left.unfinished] == [1]
    assert not left.has_gap


async def test_while_the_disk_takes_nothing_only_what_overrides_is_begun(client: Client, disk: Disk) -> None:
    disk.is_full = True
    client.begin(1)
    await eventually(lambda: bool(client.errors), "the disk is full")
    assert client.opened == [(1, True)], "nobody knew"
    for seq, command in enumerate(("hold", "land", "return", "goto"), start=2):
        client.begin(seq, command)
    await eventually(lambda: len(client.opened) == 5, "each has its answer")
    assert client.opened[1:] == [(2, True), (3, True), (4, True), (5, False)]
    disk.is_full = False
    client.begin(6, "goto")
    await eventually(lambda: client.front_size == 0, "there is room again")
    assert client.opened[-1] == (6, True)
    assert [left.id.seq for left in client.journal.unfinished] == [1, 2, 3, 4, 6]


async def test_where_there_is_no_memory_for_a_front_a_command_waits_for_the_disk(
    tmp_path: Path, memory: Path, disk: Disk
) -> None:
    memory.rmdir()
    client = Client(tmp_path / "journal")
    assert client.front is None
    disk.stall()
    client.begin(1, "hold")
    assert client.opened == []
    disk.go_on()
    await eventually(lambda: client.opened == [(1, True)], "the disk has it")
    await client.close()


async def test_a_front_without_room_leaves_it_to_the_disk(
    client: Client, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: int, data: bytes) -> None:
        os.write(file, data[:9])
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(journal_front, "write_all", full)
    disk.stall()
    client.begin(1, "hold")
    assert (client.opened, client.front_size) == ([], 0)
    disk.go_on()
    await eventually(lambda: client.opened == [(1, True)], "the disk has it")


async def test_a_front_that_had_no_room_for_a_word_takes_none_back_that_the_disk_has(
    client: Client, disk: Disk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: int, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "full")

    disk.stall()
    client.begin(1)
    monkeypatch.setattr(journal_front, "write_all", full)
    client.end(1)
    monkeypatch.setattr(journal_front.Front, "clear", lambda self: None)  # killed before that
    disk.go_on()
    await eventually(lambda: "completed" in client.path.read_text(), "the disk has it")
    left = started(client.copy(tmp_path), with_front=True)
    assert left.unfinished == [Unfinished(CommandId(1, 1), "takeoff", Word.COMPLETED)]


async def test_a_client_that_ends_opens_nothing_any_more(
    client: Client, disk: Disk, memory: Path, tmp_path: Path
) -> None:
    assert client.front is not None
    client.journal.front = None
    disk.stall()
    client.begin(1)
    closing = asyncio.create_task(client.close())
    await asyncio.sleep(0)
    disk.go_on()
    await closing
    assert client.opened == []
