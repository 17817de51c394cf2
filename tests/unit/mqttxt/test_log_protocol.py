"""What an autopilot may say of its logs, and what counts of it."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import FlightLog
from mqttxt.drone.mavlink.log_protocol import AGAIN_MS, DATA_BYTES, SILENT_ASKS, Listing, Window
from mqttxt.errors import PayloadError
from mqttxt.protocol.logs import MOST_LOGS, pack_logs, unpack_logs
from tests.simulation.world import from_autopilot


def entry(number: int, count: int, size: int = 100) -> Any:
    return from_autopilot(mavlink.MAVLink_log_entry_message(number, count, count, 5, size))


def data(number: int, offset: int, count: int, fill: int = 7) -> Any:
    return from_autopilot(mavlink.MAVLink_log_data_message(number, offset, count, [fill] * DATA_BYTES))


def test_a_list_is_bounded_and_empty_logs_are_left_out() -> None:
    listing = Listing(1)
    listing.begin(0)
    listing.on_entry(entry(2, 2, 0), 0)
    listing.on_entry(entry(2, 2, 0), 0)
    assert not listing.is_over
    listing.on_entry(entry(1, 2), 0)
    assert listing.found == (FlightLog(1, 100, 5),)
    listing = Listing(1)
    listing.on_entry(entry(1, MOST_LOGS + 1), 0)
    assert (listing.found, listing.error) == (None, f"too_many, {MOST_LOGS + 1}")


def test_only_the_bytes_that_were_asked_for_count() -> None:
    log = FlightLog(3, 1000, None)
    window = Window(1, log, 180, 450)
    window.ask(0)
    for odd in (data(4, 180, 90), data(3, 181, 90), data(3, 90, 90), data(3, 450, 90), data(3, 2**32 - 1, 90)):
        assert window.on_data(odd, 0) == []
    window.on_data(data(3, 180, 255, 1), 0)
    window.on_data(data(3, 180, 90, 2), 0)  # the first counts
    asked = window.on_data(data(3, 360, 90, 3), 0)
    assert [(one.ofs, one.count) for one in asked] == [(270, 90)]
    assert not window.is_whole
    window.on_data(data(3, 270, 90, 4), 0)
    assert window.data == bytes([1] * 90 + [4] * 90 + [3] * 90)


def test_a_last_piece_that_comes_again_and_again_is_not_asked_for_without_end() -> None:
    window = Window(1, FlightLog(3, 1000, None), 0, 270)
    window.ask(0)
    asked = [one for _ in range(100) for one in window.on_data(data(3, 180, 90), 0)]
    assert [(one.ofs, one.count) for one in asked] == [(0, 180)]
    assert window.error is None
    for turn in range(1, SILENT_ASKS + 1):
        window.due(turn * AGAIN_MS)
    assert window.error == "no_answer"


def test_a_window_that_comes_twice_with_the_same_gap_is_still_read() -> None:
    """A radio stalled, the request was repeated, and then both answers came."""
    end = 64 * DATA_BYTES
    window = Window(1, FlightLog(3, end, None), 0, end)
    window.ask(0)
    assert window.due(AGAIN_MS)
    came = [offset for offset in range(0, end, DATA_BYTES) if offset != 10 * DATA_BYTES]
    asked = [one for offset in 2 * came for one in window.on_data(data(3, offset, DATA_BYTES), AGAIN_MS)]
    assert [(one.ofs, one.count) for one in asked] == [(10 * DATA_BYTES, DATA_BYTES)]
    window.on_data(data(3, 10 * DATA_BYTES, DATA_BYTES), 2 * AGAIN_MS)
    assert (window.error, window.is_whole) == (None, True)


def test_a_log_that_ends_too_soon_has_changed() -> None:
    window = Window(1, FlightLog(3, 1000, None), 0, 180)
    window.ask(0)
    for _ in range(3):
        window.on_data(data(3, 90, 12), 0)
    assert window.error == "changed_meanwhile"


@pytest.mark.parametrize(
    "kind",
    ["log", "logs", "log.1.2", "log.65536.5.0", "log.1.0.0", "log.01.5.0", "log.1.5.4294967296", "log.1.5.0.part"],
)
def test_other_names_are_no_logs(kind: str) -> None:
    assert FlightLog.of_kind(kind) is None


def test_a_log_is_named_by_what_the_list_has_of_it() -> None:
    for log in (FlightLog(0, 1, None), FlightLog(65535, 2**32 - 1, 2**32 - 1)):
        assert FlightLog.of_kind(log.kind) == log


def test_a_list_has_each_number_once() -> None:
    twice = [FlightLog(1, 5, None), FlightLog(1, 6, None)]
    with pytest.raises(PayloadError, match="each number once"):
        unpack_logs(pack_logs(twice))
