"""A disk that is full or fails: what was recorded stays, what was not is denied, and room is all that is needed."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from itertools import chain, repeat
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mqttxt.core import disk as disks
from mqttxt.drone import journal as journals
from mqttxt.drone.answers import Unfinished
from mqttxt.drone.effects import Journal
from mqttxt.drone.journal import MOST_DELIVERED, MOST_OUTDATED, JournalFile
from mqttxt.protocol.messages import CommandId, Word
from tests.rigs.faulty_disk import FaultyDisk
from tests.rigs.small_disk import SmallDisk
from tests.unit.mqttxt.test_journal import make_whole


def opened(seq: int) -> Journal:
    return Journal(CommandId(1, seq), "takeoff")


def ids(left: list[Unfinished]) -> list[int]:
    return [one.id.seq for one in left]


def fill_until_refused(journal: JournalFile) -> list[int]:
    """Open commands until the disk takes none; which it took."""
    taken = []
    for seq in range(10_000):
        try:
            journal.record(opened(seq))
        except OSError:
            return taken
        taken.append(seq)
    raise AssertionError("never full")


def test_a_full_disk_costs_what_it_did_not_take_and_nothing_else(disk: SmallDisk, tmp_path: Path) -> None:
    path = disk.folder / "journal"
    journal = JournalFile(path)
    journal.record(opened(90_000))
    disk.fill()
    taken = [90_000, *fill_until_refused(journal)]
    with pytest.raises(OSError, match=r"."):
        journal.record(opened(90_001))
    assert ids(JournalFile(Path(shutil.copy(path, tmp_path / "copy"))).unfinished) == taken
    disk.make_room()
    journal.record(opened(90_002))
    journal.record(Journal(CommandId(1, 90_000), "takeoff", Word.COMPLETED))
    journal.close()
    left = JournalFile(path).unfinished
    assert sorted(ids(left)) == sorted([*taken, 90_002])
    assert next(one.word for one in left if one.id.seq == 90_000) is Word.COMPLETED


def test_a_last_word_that_a_full_disk_did_not_take_is_written_with_the_next_record(disk: SmallDisk) -> None:
    path = disk.folder / "journal"
    journal = JournalFile(path)
    journal.record(opened(1))
    disk.fill()
    fill_until_refused(journal)
    with pytest.raises(OSError, match=r"."):
        journal.record(Journal(CommandId(1, 1), "takeoff", Word.FAILED, "timeout"))
    disk.make_room()
    journal.record(opened(90_000))
    journal.close()
    assert Unfinished(CommandId(1, 1), "takeoff", Word.FAILED, "timeout") in JournalFile(path).unfinished


@pytest.mark.parametrize("was_there", [True, False])
def test_a_client_is_started_on_a_full_disk_and_records_once_there_is_room(disk: SmallDisk, was_there: bool) -> None:
    path = disk.folder / "journal"
    if was_there:
        before = JournalFile(make_whole(path))
        before.record(opened(1))
        before.close()
    disk.fill(to_the_brim=True)
    journal = JournalFile(path)
    assert ids(journal.unfinished) == ([1] if was_there else [])
    assert journal.has_gap is not was_there
    if not was_there:
        with pytest.raises(OSError, match=r"."):
            journal.record(opened(2))
    disk.make_room()
    journal.record(opened(3))
    journal.close()
    assert ids(JournalFile(path).unfinished) == ([1, 3] if was_there else [3])


@pytest.mark.long
def test_a_session_makes_its_journal_smaller_while_it_runs(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = JournalFile(path)
    journal.record(opened(0))
    largest = 0
    for seq in range(1, 3 * MOST_OUTDATED):
        journal.record(opened(seq))
        journal.record(Journal(CommandId(1, seq), "takeoff", Word.COMPLETED))
        journal.record(Journal(CommandId(1, seq), "takeoff", done=True))
        largest = max(largest, len(path.read_bytes().splitlines()) if seq % 100 == 0 else 0)
    assert largest <= MOST_DELIVERED + MOST_OUTDATED + 10
    journal.close()
    left = JournalFile(path).unfinished
    assert ids(left) == [0, *range(3 * MOST_OUTDATED - MOST_DELIVERED, 3 * MOST_OUTDATED)]


def test_a_file_system_that_syncs_no_folder_is_good_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsync = os.fsync

    def of_files_only(file: int) -> None:
        if os.path.isdir(f"/proc/self/fd/{file}"):
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        fsync(file)

    monkeypatch.setattr(journals.os, "fsync", of_files_only)
    journal = JournalFile(tmp_path / "journal")
    journal.record(opened(1))
    journal.close()
    assert ids(JournalFile(tmp_path / "journal").unfinished) == [1]


FAULTS = st.sampled_from(["", "", "", "", "partly", "write", "sync", "open"])
RECORDS = st.lists(st.tuples(st.integers(1, 4), st.sampled_from(["open", "said", "done", "restart"])), max_size=20)


LATE_WORD = [(1, what) for what in ("open", "said", "restart", "done", "restart")]
"""A last word that the disk did not take, and its delivery in the next session."""


@given(RECORDS, st.lists(FAULTS, max_size=60))
@example(LATE_WORD, [""] * 7 + ["write"])
@example(LATE_WORD, [""] * 8 + ["sync"])
def test_what_was_said_to_be_recorded_is_there_whatever_failed_before_and_after(
    tmp_path_factory: pytest.TempPathFactory, records: list[tuple[int, str]], faults: list[str]
) -> None:
    path = tmp_path_factory.mktemp("faulty") / "journal"
    must_have: dict[int, set[Word | None]] = {}
    with pytest.MonkeyPatch.context() as patch:
        faulty = FaultyDisk(chain(faults, repeat("")))
        patch.setattr(journals, "os", faulty)
        patch.setattr(disks, "os", faulty)
        journal = JournalFile(path)
        for seq, what in records:
            command_id = CommandId(1, seq)
            if what == "restart":
                journal.close()
                journal = JournalFile(path)
                continue
            effect = {
                "open": Journal(command_id, "arm"),
                "said": Journal(command_id, "arm", Word.COMPLETED),
                "done": Journal(command_id, "arm", done=True),
            }[what]
            known = must_have.get(seq, set())
            if {"open": bool(known), "said": known != {None}, "done": Word.COMPLETED not in known}[what]:
                continue  # an id is opened once, then said once, then done
            with contextlib.suppress(OSError):
                journal.record(effect)
                if what != "done":
                    must_have[seq] = {effect.word}
                continue
            if what == "said":
                must_have[seq].add(Word.COMPLETED)  # it may come with the next record, or not at all
        journal.close()
    journal = JournalFile(path)
    journal.close()
    found = {left.id.seq: left.word for left in journal.unfinished}
    assert must_have.keys() <= found.keys()
    assert all(found[seq] in words for seq, words in must_have.items())
