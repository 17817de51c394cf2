"""Flight logs: every byte arrives or none does, whatever is lost, cut off, full or hostile, and no flight waits."""

from __future__ import annotations

import asyncio
import os
import random
import threading
import zlib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import ConfigurationError, FlightLog, LogProgress, TransferFailed
from mqttxt.drone.log_work import BLOCK_BYTES
from mqttxt.drone.logs import reader
from mqttxt.drone.logs.files import LogFiles
from mqttxt.drone.logs.reader import MOST_BYTES_S, MOST_MESSAGES, WAY_MS
from mqttxt.drone.mavlink.log_protocol import DATA_BYTES, SILENT_ASKS
from mqttxt.protocol.bulk import MOST_BYTES, Have, Making
from mqttxt.protocol.commands import Arm, SetParameter
from mqttxt.protocol.logs import LOGS, unpack_logs
from mqttxt.protocol.plans import hash_of
from mqttxt.station.log_download import LogDownload, _Part
from mqttxt.station.transfers import Fetching
from sitl.logs import Log, made_up
from tests.examples import first_quick
from tests.simulation.far import FarFlight
from tests.simulation.flight import Flight

KINDS = ("px4", "ardupilot")
LONG = made_up(1_767_230_000, 6 * BLOCK_BYTES + 1234)
"""Six blocks and some."""


class Station:
    """What a LogDownload needs of its station's runner; time passes while it waits. `cut` may end it at any time."""

    def __init__(self, flight: Flight) -> None:
        self.flight = flight
        self.cut: Callable[[], bool] = lambda: False

    async def transfer(self, transfer: Any, _: object, on_news: Callable[[], Awaitable[None]] | None = None) -> None:
        flight, end_ms = self.flight, self.flight.now_ms + 3_600_000
        flight.run("gs", flight.gs.transfers.begin(transfer, flight.now_ms))
        while not transfer.is_over:
            flight.fly(0.1)
            assert flight.now_ms < end_ms
            if self.cut():
                transfer.end()
                raise TransferFailed("cut")
            if transfer.has_news and on_news is not None:
                await on_news()
        if transfer.error is not None:
            raise TransferFailed(f"{transfer}: {transfer.error}")


class Ground:
    """A station, a fog and a drone with a folder, in time."""

    def __init__(self, folder: Path, like: str = "px4", make: type[Flight] = Flight, **options: Any) -> None:
        self.files = LogFiles(folder / "drone", reserve_bytes=0)
        kind = mavlink.MAV_AUTOPILOT_PX4 if like == "px4" else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        self.flight = make(logs_folder=self.files, kind=kind, **options)
        self.flight.begin(like)
        self.flight.fly(5)
        self.station = Station(self.flight)
        self.target = folder / "flight.log"
        self.told: list[LogProgress] = []
        self.written: list[Any] = []
        """What the drone has written to its autopilot, heartbeats left out."""
        write = self.flight._write

        def note(effect: Any) -> None:
            if effect.message.get_type() != "HEARTBEAT":
                self.written.append(effect.message)
            write(effect)

        self.flight._write = note  # type: ignore[method-assign]

    @property
    def kept(self) -> list[Log]:
        kept: list[Log] = self.flight.vehicle.autopilot.logs.kept
        return kept

    def only(self, log: Log) -> FlightLog:
        """Let the autopilot have this log alone; as it is listed."""
        self.kept[:] = [log]
        (listed,) = self.list()
        return listed

    def list(self) -> tuple[FlightLog, ...]:
        fetching = Fetching(self.flight.gs.fog(1), 1, LOGS)
        asyncio.run(self.station.transfer(fetching, None))
        return unpack_logs(fetching.data)

    def get(self, log: FlightLog, most_bytes_s: int = 10**9) -> bytes:
        runner: Any = self.station
        download = LogDownload(runner, self.flight.gs.fog(1), 1, log, self.target, most_bytes_s, self.told.append)
        asyncio.run(download.run(None))
        return self.target.read_bytes()

    def get_up_to_a_cut(self, log: FlightLog) -> bytes | None:
        """The log; None where it was cut off."""
        try:
            return self.get(log)
        except TransferFailed as error:
            if str(error) != "cut":
                raise
            return None

    def done(self, log: FlightLog) -> int:
        """How many bytes the drone has read."""
        found = self.flight.uav.desk.executor.logs.progress(log)
        return found.done if isinstance(found, Making) else 0

    def asked(self) -> list[Any]:
        """What the autopilot was asked of logs."""
        return [one for one in self.written if one.get_type().startswith("LOG_")]

    def read_bytes(self) -> int:
        return sum(one.count for one in self.asked() if one.get_type() == "LOG_REQUEST_DATA")

    def restart_uav(self) -> None:
        self.flight.restart_uav(random.randrange(1, 2**32), [])
        self.flight.fly(5)

    def loses(self, share: float) -> None:
        """LOG messages get lost in both directions."""
        rng, hear, write = random.Random(9), self.flight._hear, self.flight._write

        def some(messages: list[Any]) -> None:
            hear([one for one in messages if "LOG_" not in one.get_type() or rng.random() >= share])

        def sometimes(effect: Any) -> None:
            if "LOG_" not in effect.message.get_type() or rng.random() >= share:
                write(effect)

        self.flight._hear, self.flight._write = some, sometimes  # type: ignore[method-assign]


@pytest.fixture
def ground(tmp_path: Path) -> Ground:
    return Ground(tmp_path)


# -- all of it --------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("like", first_quick(KINDS))
def test_a_log_arrives_as_the_autopilot_has_it(like: str, signed: bool, tmp_path: Path) -> None:
    ground = Ground(tmp_path, like, signed=signed)
    listed = ground.list()
    first = 0 if like == "px4" else 1
    assert [(log.number, log.size, log.time_s) for log in listed] == [
        (number, len(kept.data), kept.time_s) for number, kept in enumerate(ground.kept, first)
    ]
    assert ground.get(listed[1]) == ground.kept[1].data
    assert [one.done for one in ground.told if not one.is_at_drone] == sorted(
        one.done for one in ground.told if not one.is_at_drone
    )
    assert ground.told[-1].done == ground.told[-1].size < listed[1].size
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["flight.log"]


@pytest.mark.long
@pytest.mark.parametrize("like", first_quick(KINDS))
def test_what_is_lost_between_autopilot_and_drone_is_asked_for_again(like: str, tmp_path: Path) -> None:
    ground = Ground(tmp_path, like)
    ground.loses(0.2)
    log = ground.list()[0]
    assert ground.get(log) == ground.kept[0].data
    assert log.size < ground.read_bytes() < 3 * log.size


@pytest.mark.long
def test_a_log_comes_over_two_seconds_of_round_trip_and_loss_and_commands_are_not_behind_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ground = Ground(tmp_path, make=FarFlight)
    flight = ground.flight
    assert isinstance(flight, FarFlight)
    flight.is_far = True
    log = ground.list()[0]
    delays_s: list[float] = []

    def while_it_comes() -> bool:
        if len(delays_s) < 10 and ground.told and ground.told[-1].is_at_drone:
            delays_s.append(_delay_s(flight))
        return False

    ground.station.cut = while_it_comes
    begun_ms = flight.now_ms
    assert ground.get(log) == ground.kept[0].data
    took_s = (flight.now_ms - begun_ms) / 1000
    alone = [_delay_s(flight) for _ in range(10)]
    assert len(delays_s) == 10
    assert sum(delays_s) / 10 < sum(alone) / 10 + 1.5
    with capsys.disabled():
        told = f"{log.size} bytes ({ground.told[-1].size} compressed) in {took_s:.0f} s"
        means = f"{sum(delays_s) / 10:.2f} s meanwhile, {sum(alone) / 10:.2f} s alone"
        print(f"\ngeo-2s: {told}; a command's last word after {means}")


def _delay_s(flight: Flight) -> float:
    """From a command's sending to its last word: of one that the drone denies at once."""
    begun_ms, sent = flight.now_ms, flight.send(SetParameter("SYS_AUTOSTART", 1), ttl_ms=60_000)
    while flight.last_of(sent) is None:
        flight.fly(0.02)
    return (flight.now_ms - begun_ms) / 1000


# -- cut off ----------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("like", first_quick(KINDS))
@pytest.mark.parametrize("who", ["station", "both"])
def test_a_transfer_that_is_cut_anywhere_goes_on_where_it_was(like: str, who: str, tmp_path: Path) -> None:
    """Every second of it; what was read is read again up to one block, and what was carried not at all."""
    ground = Ground(tmp_path, like)
    log = ground.only(LONG)
    cuts = 0
    for _ in range(200):
        until_ms = ground.flight.now_ms + 1000
        ground.station.cut = lambda until_ms=until_ms: ground.flight.now_ms >= until_ms  # type: ignore[misc]
        found = ground.get_up_to_a_cut(log)
        if found is not None:
            break
        cuts += 1
        if who == "station":
            continue
        if not any(one.is_at_drone for one in ground.told):
            ground.flight.fly(1.6)  # two blocks' worth: the last one is read again
        ground.restart_uav()
    assert cuts >= 3
    assert ground.target.read_bytes() == LONG.data
    assert ground.read_bytes() <= log.size + cuts * (BLOCK_BYTES if who == "station" else 2 * BLOCK_BYTES)
    carried = [one.done for one in ground.told if one.is_at_drone]
    assert carried == sorted(carried)


@pytest.mark.long
def test_an_autopilot_that_starts_anew_is_listed_anew_and_gives_its_last_bytes_again(ground: Ground) -> None:
    log = ground.only(LONG)
    _stop_behind(ground, log, 2 * BLOCK_BYTES)
    before = ground.read_bytes()
    ground.flight.uav.vehicle.boots.restarts += 1
    ground.station.cut = lambda: False
    assert ground.get(log) == LONG.data
    assert ground.read_bytes() - before <= log.size - BLOCK_BYTES


@pytest.mark.long
def test_what_was_read_of_another_log_with_the_same_number_is_not_mixed_into_it(ground: Ground) -> None:
    log = ground.only(LONG)
    _stop_behind(ground, log, 2 * BLOCK_BYTES)
    other = Log(LONG.time_s, bytes(reversed(LONG.data)))
    ground.kept[:] = [other]
    ground.restart_uav()
    ground.station.cut = lambda: False
    assert ground.get(log) == other.data


def _stop_behind(ground: Ground, log: FlightLog, done: int) -> None:
    """Cut it off once so much of it has been read."""
    ground.station.cut = lambda: ground.done(log) > done
    with pytest.raises(TransferFailed, match="cut"):
        ground.get(log)


# -- what an autopilot does with its logs -----------------------------------------------------------------------------


@pytest.mark.long
def test_a_log_that_grows_is_given_as_long_as_it_was_listed(ground: Ground) -> None:
    log = ground.list()[1]
    before = ground.kept[1].data
    ground.kept[1] = Log(ground.kept[1].time_s + 60, before + bytes(5000))
    assert ground.get(log) == before


@pytest.mark.parametrize(
    "now", [[], [made_up(5, 40_000)], [made_up(1_767_225_600, 39_999)], [made_up(9, 50_000), made_up(2**31, 7)]]
)
def test_a_log_that_is_not_there_any_more_is_refused(now: list[Log], ground: Ground) -> None:
    log = ground.list()[0]
    ground.kept[:] = now
    with pytest.raises(TransferFailed, match="no_such_log"):
        ground.get(log)


def test_logs_that_change_while_one_is_read_are_noticed_at_the_end(ground: Ground) -> None:
    log = ground.list()[0]

    def erased() -> bool:
        if ground.done(log) > 20_000:
            ground.kept[:] = [Log(77, os.urandom(60_000)), Log(99, b"newest")]
        return False

    ground.station.cut = erased
    with pytest.raises(TransferFailed, match="changed_meanwhile"):
        ground.get(log)
    assert not list(ground.files.folder.iterdir())


@pytest.mark.parametrize("like", KINDS)
def test_an_autopilot_without_logs_has_an_empty_list(like: str, tmp_path: Path) -> None:
    ground = Ground(tmp_path, like)
    ground.kept.clear()
    assert ground.list() == ()


def test_an_autopilot_that_says_nothing_of_logs_is_asked_a_few_times(ground: Ground) -> None:
    log = ground.list()[0]
    ground.flight.vehicle.muted = {"LOG_ENTRY", "LOG_DATA"}
    ground.flight.fly(2)
    ground.written.clear()
    with pytest.raises(TransferFailed, match=r"logs: no_answer"):
        ground.list()
    with pytest.raises(TransferFailed, match=r"log\.0\.40000\..*: no_answer"):
        ground.get(log)
    assert [one.get_type() for one in ground.asked()].count("LOG_REQUEST_LIST") == 2 * SILENT_ASKS


@pytest.mark.long
def test_an_autopilot_that_is_silent_for_a_while_is_waited_for_and_not_asked(ground: Ground) -> None:
    log = ground.list()[1]

    def silent() -> bool:
        if ground.done(log) > 20_000 and not ground.flight.vehicle.muted:
            ground.flight.vehicle.muted = {"HEARTBEAT", "LOG_DATA"}
            ground.flight.fly(3.5)
            ground.written.clear()
            ground.flight.fly(4)
            assert ground.asked() == []
            ground.flight.vehicle.muted = {"NOTHING"}
        return False

    ground.station.cut = silent
    assert ground.get(log) == ground.kept[1].data


def test_without_heartbeats_nothing_is_asked_for_though_the_log_still_comes(ground: Ground) -> None:
    """It may have been armed since (R18.3)."""
    log = ground.only(LONG)
    hear, late = ground.flight._hear, list[Any]()

    def slowly(messages: list[Any]) -> None:
        late.extend(one for one in messages if one.get_type() == "LOG_DATA")
        hear([one for one in messages if one.get_type() != "LOG_DATA"])

    def silent() -> bool:
        if ground.done(log) < 5000:
            return False
        ground.flight._hear = slowly  # type: ignore[method-assign]
        ground.flight.vehicle.muted = {"HEARTBEAT"}
        ground.flight.fly(4.5)
        ground.written.clear()
        assert late
        hear(late)
        return True

    ground.station.cut = silent
    assert ground.get_up_to_a_cut(log) is None
    assert [one for one in ground.asked() if one.get_type() != "LOG_REQUEST_END"] == []


# -- in flight --------------------------------------------------------------------------------------------------------


def test_nothing_is_asked_of_an_armed_autopilot_and_what_is_there_is_given_in_flight(ground: Ground) -> None:
    listed = ground.list()
    assert ground.get(listed[0]) == ground.kept[0].data
    ground.flight.set(armed=True)
    ground.flight.fly(3)
    ground.written.clear()
    for failing in (ground.list, lambda: ground.get(listed[1])):
        with pytest.raises(TransferFailed, match="armed"):
            failing()
    ground.target.unlink()
    assert ground.get(listed[0]) == ground.kept[0].data
    assert ground.asked() == []


@pytest.mark.long
@pytest.mark.parametrize("like", first_quick(KINDS))
def test_arming_ends_the_reading_and_disarmed_it_goes_on_where_it_was(like: str, tmp_path: Path) -> None:
    ground = Ground(tmp_path, like)
    log = ground.only(LONG)

    def armed() -> bool:
        if ground.done(log) > 2 * BLOCK_BYTES and not ground.flight.vehicle.autopilot.armed:
            ground.flight.set(armed=True)
            ground.flight.fly(1.5)  # a heartbeat shows it
            ground.written.clear()
        return False

    ground.station.cut = armed
    with pytest.raises(TransferFailed, match="armed"):
        ground.get(log)
    ground.flight.fly(10)
    assert [one for one in ground.asked() if one.get_type() != "LOG_REQUEST_END"] == []
    ground.station.cut = lambda: False
    ground.flight.set(armed=False)
    ground.flight.fly(3)
    assert ground.get(log) == LONG.data
    assert ground.read_bytes() < log.size - BLOCK_BYTES + 2000


@pytest.mark.parametrize("like", KINDS)
def test_a_command_goes_before_a_log(like: str, tmp_path: Path) -> None:
    """The autopilot is told to stop, then gets the command, and is asked for nothing more for two seconds."""
    ground = Ground(tmp_path, like)
    log = ground.only(LONG)
    at_ms: list[int] = []

    def commanded() -> bool:
        if not at_ms and ground.done(log) > 5000:
            at_ms.append(ground.flight.now_ms)
            ground.written.clear()
            ground.flight.send(Arm())
            ground.flight.fly(WAY_MS / 1000 - 0.2)
            kinds = [one.get_type() for one in ground.written]
            assert kinds[:2] == ["LOG_REQUEST_END", "COMMAND_LONG"]
            assert not {"LOG_REQUEST_LIST", "LOG_REQUEST_DATA"} & {*kinds}
        return False

    ground.station.cut = commanded
    with pytest.raises(TransferFailed, match="armed"):
        ground.get(log)
    assert at_ms


@pytest.mark.long
def test_an_autopilot_is_asked_for_little_at_a_time(ground: Ground) -> None:
    log = ground.only(LONG)
    begun_ms = ground.flight.now_ms
    assert ground.get(log) == LONG.data
    counts = [one.count for one in ground.asked() if one.get_type() == "LOG_REQUEST_DATA"]
    assert max(counts) == MOST_MESSAGES * DATA_BYTES
    read_ms = next(ms for ms, told in [(ground.flight.now_ms, ground.told)] if told)
    assert read_ms - begun_ms >= log.size * 1000 / MOST_BYTES_S


@pytest.mark.long
def test_a_log_that_nobody_asks_for_any_more_is_read_no_further(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, "WANTED_MS", 3000)
    log = ground.only(made_up(5, 800_000))
    _stop_behind(ground, log, 1000)
    ground.flight.fly(2)
    assert ground.done(log) > 60_000
    ground.flight.fly(2)
    ground.written.clear()
    ground.flight.fly(3)
    assert ground.asked() == []


# -- full disks and memory --------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_full_disk_ends_a_reading_with_that_word(ground: Ground) -> None:
    log = ground.list()[0]
    ground.files._reserve_bytes = 2**60
    with pytest.raises(TransferFailed, match="disk_full"):
        ground.get(log)
    assert not ground.target.exists()
    assert [one.kind for one in ground.flight.logs][-2:] == ["logs", "object_refused"]
    ground.files._reserve_bytes = 0
    assert ground.get(log) == ground.kept[0].data


def test_a_list_that_is_longer_than_memory_allows_is_not_taken(tmp_path: Path) -> None:
    fetching = Fetching(Ground(tmp_path).flight.gs.fog(1), 1, LOGS)
    fetching.take(Have(bytes(16), MOST_BYTES + 1, ()), 0)
    assert (fetching.is_over, fetching.error) == (True, "too_long")


# -- the station's disk -----------------------------------------------------------------------------------------------


def test_what_is_not_the_log_is_never_a_file(tmp_path: Path, ground: Ground) -> None:
    """A drone that compresses more than it said, or something else."""
    log = ground.list()[0]
    for wrong in (zlib.compress(bytes(10_000_000)), zlib.compress(bytes(39_999)), os.urandom(500)):
        for path in ground.files.folder.iterdir():
            path.unlink()
        (ground.files.folder / f"{log.kind}.{hash_of(wrong).hex()}.z").write_bytes(wrong)
        with pytest.raises(TransferFailed, match="expected a log of 40000 bytes"):
            ground.get(log)
        assert [path.name for path in tmp_path.iterdir()] == ["drone"]


def test_a_disk_that_changed_what_had_come_begins_anew(tmp_path: Path, ground: Ground) -> None:
    log = ground.list()[0]
    ground.station.cut = lambda: bool(ground.told) and ground.told[-1].is_at_drone and ground.told[-1].done > 3000
    with pytest.raises(TransferFailed, match="cut"):
        ground.get(log, 5000)
    (part,) = tmp_path.glob(".flight.log.*.part")
    part.write_bytes(bytes(len(part.read_bytes())))
    ground.station.cut = lambda: False
    assert ground.get(log) == ground.kept[0].data


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path, ground: Ground) -> None:
    ground.target = tmp_path / "nowhere" / "flight.log"
    with pytest.raises(ConfigurationError, match=r"nowhere/flight\.log: no such folder; expected a file in a folder"):
        ground.get(ground.list()[0])


def test_a_pipe_is_not_replaced_by_a_log_and_nothing_is_asked_for_it(tmp_path: Path, ground: Ground) -> None:
    log = ground.list()[0]
    os.mkfifo(ground.target)
    with pytest.raises(ConfigurationError, match=r"flight\.log: not a regular file; expected a file"):
        ground.get(log)
    assert ground.target.is_fifo()
    assert (ground.told, ground.read_bytes()) == ([], 0)


def test_a_log_is_written_where_a_link_leads(tmp_path: Path, ground: Ground) -> None:
    (tmp_path / "disk").mkdir()
    ground.target.symlink_to("disk/1.ulg")
    assert ground.get(ground.list()[0]) == ground.kept[0].data
    assert ground.target.is_symlink()
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["1.ulg"]


def test_a_thread_that_is_late_writes_into_no_other_file(tmp_path: Path) -> None:
    """A cancelled download closes its file, whose descriptor the next one gets: it may be a connection."""
    part = _Part(tmp_path / "log", b"h" * 16, 100)
    part.open()
    part.close()
    other = tmp_path / "other"
    with other.open("wb"), pytest.raises(ConfigurationError):
        part.write(b"late")
    assert other.read_bytes() == b""


async def test_a_download_that_is_cancelled_while_its_file_opens_leaves_no_file_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Runner:
        async def transfer(self, waited: Any, *_: Any) -> None:
            waited.hash, waited.size = b"h" * 16, 100

    opening, may_go_on, opened = threading.Event(), threading.Event(), list[int]()
    system = os.open

    def slow(*how: Any) -> int:
        opening.set()
        may_go_on.wait(10)
        opened.append(system(*how))
        return opened[-1]

    download = LogDownload(Runner(), None, 1, FlightLog(1, 100), tmp_path / "log", 1024, None)  # type: ignore[arg-type]
    task = asyncio.create_task(download.run(None))
    monkeypatch.setattr(os, "open", slow)
    await asyncio.to_thread(opening.wait, 10)
    task.cancel()
    await asyncio.sleep(0)
    may_go_on.set()
    with pytest.raises(asyncio.CancelledError):
        await task
    await asyncio.get_running_loop().shutdown_default_executor()
    assert len(opened) == 1
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(opened[0])
