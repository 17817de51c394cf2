"""Flight logs on the drone's disk: whole or not there, whatever fills it."""

from __future__ import annotations

import asyncio
import os
import zlib
from pathlib import Path
from typing import Any

import pytest

from mqttxt import ConfigurationError, FlightLog
from mqttxt.core import disk
from mqttxt.drone.log_work import (
    BLOCK_BYTES,
    FinishLog,
    LoadLog,
    LogFault,
    LogFinished,
    LogLoaded,
    LogOpened,
    LogWritten,
    OpenLog,
    WriteLog,
)
from mqttxt.drone.logs.files import LogFiles
from mqttxt.drone.logs.port import MOST_LOADS, LogPort
from mqttxt.protocol.bulk import BulkAsk, Get
from mqttxt.protocol.plans import hash_of
from tests.rigs.processes import eventually

A_LOG = FlightLog(1, 2 * BLOCK_BYTES, 5)


def written(files: LogFiles, log: FlightLog, plain: bytes) -> Any:
    """Write a log in blocks; the last answer."""
    done: Any = None
    for offset in range(0, len(plain), BLOCK_BYTES):
        done = files.carry_out(WriteLog(1, log, offset, plain[offset : offset + BLOCK_BYTES]))
    return done


def test_a_whole_log_is_known_by_its_hash_and_outlives_the_process(tmp_path: Path) -> None:
    files, plain = LogFiles(tmp_path, reserve_bytes=0), os.urandom(A_LOG.size)
    assert isinstance(written(files, A_LOG, plain), LogWritten)
    finished = files.carry_out(FinishLog(2, A_LOG))
    assert isinstance(finished, LogFinished)
    opened = LogFiles(tmp_path).carry_out(OpenLog(3, A_LOG))
    assert isinstance(opened, LogOpened)
    assert opened.whole == finished.whole
    (path,) = tmp_path.iterdir()
    assert hash_of(path.read_bytes()) == finished.whole.hash
    assert zlib.decompress(path.read_bytes()) == plain
    get = Get(5, 20, finished.whole.hash)
    ask = BulkAsk(gs_session=1, kind=A_LOG.kind, nonce=1, ask=get)
    loaded = files.carry_out(LoadLog(ask, get, finished.whole.hash, A_LOG))
    assert isinstance(loaded, LogLoaded)
    assert (loaded.data, loaded.size) == (path.read_bytes()[5:25], finished.whole.size)
    gone = files.carry_out(LoadLog(ask, get, bytes(16), A_LOG))
    assert isinstance(gone, LogLoaded)
    assert gone.data is None


@pytest.mark.parametrize("there", [0, 1, 89, BLOCK_BYTES - 1, BLOCK_BYTES, BLOCK_BYTES + 1, 2 * BLOCK_BYTES])
def test_the_last_block_of_a_log_in_part_does_not_count(there: int, tmp_path: Path) -> None:
    files, plain = LogFiles(tmp_path, reserve_bytes=0), os.urandom(A_LOG.size)
    (tmp_path / f"{A_LOG.kind}.part").write_bytes(plain[:there])
    opened = files.carry_out(OpenLog(1, A_LOG))
    assert isinstance(opened, LogOpened)
    assert opened.done in range(max(0, there - BLOCK_BYTES), max(1, there))
    assert opened.done % BLOCK_BYTES == 0
    assert opened.tail == plain[max(0, opened.done - 900) : opened.done]


def test_a_disk_that_is_full_is_one_word_and_keeps_room_for_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = LogFiles(tmp_path, reserve_bytes=2**60)
    fault = files.carry_out(WriteLog(1, A_LOG, 0, b"x"))
    assert isinstance(fault, LogFault)
    assert (fault.reason, [*tmp_path.iterdir()]) == ("disk_full", [])

    def full(*_: Any) -> int:
        raise OSError(28, "No space left on device")

    files = LogFiles(tmp_path, reserve_bytes=0)
    monkeypatch.setattr(disk.os, "write", full)
    fault = files.carry_out(WriteLog(1, A_LOG, 0, b"x"))
    assert isinstance(fault, LogFault)
    assert fault.reason == "disk_full"


def test_a_folder_that_cannot_be_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match=r"--logs .*file: File exists; expected a folder"):
        LogFiles(tmp_path / "file")


def test_what_was_touched_longest_ago_makes_room_and_no_log_takes_more_than_half(tmp_path: Path) -> None:
    files = LogFiles(tmp_path, 10_000, reserve_bytes=0)
    for number in range(1, 5):
        log = FlightLog(number, 2000, 5)
        assert isinstance(written(files, log, os.urandom(2000)), LogWritten)
        files.carry_out(FinishLog(1, log))
        os.utime(next(tmp_path.glob(f"{log.kind}.*.z")), (number, number))
    assert sorted(path.name.split(".")[1] for path in tmp_path.iterdir()) == ["2", "3", "4"]
    fault = files.carry_out(WriteLog(1, FlightLog(9, 5001, 5), 0, b"x"))
    assert isinstance(fault, LogFault)
    assert fault.reason == "too_long, 5000"


async def test_requests_for_bytes_do_not_pile_up_before_a_disk_that_stalls(tmp_path: Path) -> None:
    files, log = LogFiles(tmp_path), FlightLog(1, 1000, None)
    done: list[Any] = []
    port = LogPort(files, done.append)
    get = Get(0, 1024, hash_of(b""))
    ask = BulkAsk(gs_session=1, kind=log.kind, nonce=1, ask=get)
    for _ in range(10 * MOST_LOADS):
        port.does[LoadLog](LoadLog(ask, get, hash_of(b""), log))
    port.does[OpenLog](OpenLog(1, log))
    running = asyncio.create_task(port.run())
    await eventually(lambda: any(isinstance(one, LogOpened) for one in done), "the reading goes on")
    running.cancel()
    await asyncio.wait({running})
    assert [type(one) for one in done] == [LogLoaded] * MOST_LOADS + [LogOpened]
