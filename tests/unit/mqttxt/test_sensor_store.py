"""The drone's store of readings: durable, bounded, one owner, and a broken file is one line."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from mqttxt.drone.effects import LoadReadings, StoreReading
from mqttxt.drone.sensors.store import Batch, SensorStore
from mqttxt.errors import ConfigurationError
from tests.rigs.small_disk import SmallDisk
from tests.simulation.carrying import reading

KILLED = """
import os, pathlib, sys
from mqttxt.drone.sensors.store import Batch, SensorStore
from mqttxt.protocol.readings import Reading, ReadingMessage
from mqttxt.drone.effects import StoreReading
store = SensorStore(pathlib.Path(sys.argv[1]))
for seq in range(5):
    message = ReadingMessage(boot=1, seq=seq, time_ms=seq, value=seq)
    store.carry_out(Batch(store=[StoreReading(Reading(1, "light", message))]))
os.kill(os.getpid(), 9)
"""


def storing(*seqs: int) -> Batch:
    return Batch(store=[StoreReading(reading(seq)) for seq in seqs])


def loaded(store: SensorStore, after: int = 0, most: int = 100) -> list[int]:
    rows = store.carry_out(Batch(load=LoadReadings(after, most))).rows
    return [found.message.seq for _, found in rows]


def test_what_was_stored_is_there_after_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "sensors"
    assert subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False).returncode == -9
    assert loaded(SensorStore(path)) == [0, 1, 2, 3, 4]


def test_readings_are_loaded_oldest_first_from_a_place_on(tmp_path: Path) -> None:
    store = SensorStore(tmp_path / "sensors")
    store.carry_out(storing(5, 3, 9))
    rows = store.carry_out(Batch(load=LoadReadings(0, 2))).rows
    assert [found for _, found in rows] == [reading(5), reading(3)]
    assert loaded(store, after=rows[-1][0]) == [9]


def test_places_only_rise_so_that_what_is_stored_after_a_removal_is_behind_it(tmp_path: Path) -> None:
    store = SensorStore(tmp_path / "sensors")
    store.carry_out(storing(0, 1))
    place = store.carry_out(Batch(load=LoadReadings(0, 2))).rows[-1][0]
    store.carry_out(Batch(forget=[reading(0).key, reading(1).key]))
    store.carry_out(storing(2))
    assert loaded(store, after=place) == [2]


def test_a_reading_that_is_there_counts_as_stored_and_takes_no_room(tmp_path: Path) -> None:
    store = SensorStore(tmp_path / "sensors", limit=2)
    store.carry_out(storing(0, 1))
    done = store.carry_out(storing(0, 1))
    assert (len(done.stored), done.refused, len(store)) == (2, [], 2)


def test_a_full_store_refuses_the_newest_and_keeps_what_it_said_it_had(tmp_path: Path) -> None:
    store = SensorStore(tmp_path / "sensors", limit=2)
    done = store.carry_out(storing(0, 1, 2))
    assert [effect.reading.message.seq for effect in done.refused] == [2]
    assert "full with 2 readings" in done.reason
    store.carry_out(Batch(forget=[reading(0).key]))
    assert store.carry_out(storing(2)).refused == []
    assert loaded(store) == [1, 2]


def test_the_limit_counts_what_an_earlier_process_left(tmp_path: Path) -> None:
    store = SensorStore(tmp_path / "sensors", limit=2)
    store.carry_out(storing(0, 1))
    store.close()
    assert len(SensorStore(tmp_path / "sensors", limit=2).carry_out(storing(2)).refused) == 1


def test_an_error_of_the_disk_refuses_the_whole_batch(tmp_path: Path) -> None:
    store = SensorStore(tmp_path / "sensors")
    store.carry_out(storing(0))
    store._database.execute("PRAGMA max_page_count = 1")
    done = store.carry_out(Batch(store=[StoreReading(reading(seq)) for seq in range(1, 2000)]))
    assert (done.failed, len(done.refused), done.stored) == (True, 1999, [])
    assert "database or disk is full" in done.reason
    assert (len(store), loaded(store)) == (1, [0])


def test_a_spoilt_reading_is_removed_and_those_behind_it_are_loaded(tmp_path: Path) -> None:
    store = SensorStore(tmp_path / "sensors")
    store.carry_out(storing(0, 1, 2))
    store._database.execute("UPDATE reading SET payload = x'00' WHERE seq = 0")
    assert loaded(store, most=2) == [1, 2]
    assert len(store) == 2


@pytest.mark.long
def test_a_store_that_another_process_uses_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "sensors"
    first = SensorStore(path)
    with pytest.raises(ConfigurationError, match=f"--sensor-store {path}: cannot be used: database is locked"):
        SensorStore(path)
    first.close()


@pytest.mark.parametrize("content", [b"readings " * 200, bytes(8192)])
def test_a_file_that_is_no_database_is_set_aside_and_a_new_one_takes_readings(
    tmp_path: Path, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "sensors"
    path.write_bytes(content)
    (tmp_path / "sensors.spoilt-1").write_bytes(b"an earlier one")
    store = SensorStore(path)
    assert store.carry_out(storing(0)).refused == []
    assert loaded(store) == [0]
    assert (tmp_path / "sensors.spoilt-1").read_bytes() == b"an earlier one"
    assert (tmp_path / "sensors.spoilt-2").read_bytes() == content
    assert caplog.messages == [
        f"{path}: file is not a database; it is kept as sensors.spoilt-2, and a new file takes the readings"
    ]


def test_a_store_whose_pages_turn_out_to_be_spoilt_is_set_aside_and_places_go_on_rising(tmp_path: Path) -> None:
    """SQLite looks at a page when it needs it: at the start all seems well."""
    path = tmp_path / "sensors"
    store = SensorStore(path)
    store.carry_out(storing(*range(2000)))
    place = store.carry_out(Batch(load=LoadReadings(0, 1000))).rows[-1][0]
    (root,) = store._database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'reading'").fetchone()
    (size,) = store._database.execute("PRAGMA page_size").fetchone()
    store.close()
    store._is_open = False
    spoilt = bytearray(path.read_bytes())
    spoilt[(root - 1) * size : root * size] = b"\xff" * size
    path.write_bytes(spoilt)
    assert [store.carry_out(storing(5000)).failed for _ in range(2)] == [True, False]
    assert (tmp_path / "sensors.spoilt-1").stat().st_size == len(spoilt)
    assert (len(store), loaded(store, after=place)) == (1, [5000])


def test_a_store_of_a_later_version_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "sensors"
    with sqlite3.connect(path) as later:
        later.execute("PRAGMA user_version = 2")
    later.close()
    with pytest.raises(ConfigurationError, match="expected version 1 of its tables, got 2"):
        SensorStore(path)


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match=r"--sensor-store .*: cannot be used: "):
        SensorStore(tmp_path / "file" / "sensors")


@pytest.mark.parametrize("was_there", [True, False])
def test_a_store_is_started_on_a_full_disk_and_takes_readings_once_there_is_room(
    disk: SmallDisk, was_there: bool
) -> None:
    path = disk.folder / "sensors"
    if was_there:
        before = SensorStore(path)
        before.carry_out(storing(0))
        before.close()
    disk.fill(to_the_brim=True)
    store = SensorStore(path)
    done = store.carry_out(storing(1))
    assert (done.failed, len(done.refused)) == (True, 1)
    assert "full" in done.reason or "I/O" in done.reason
    disk.make_room()
    assert len(store.carry_out(storing(2)).stored) == 1
    assert loaded(store) == ([0, 2] if was_there else [2])
    store.close()
