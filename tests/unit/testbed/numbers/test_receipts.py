"""What autopilots got of the calls: each once, again, or after the caller had its last word; and how long it took."""

from __future__ import annotations

from typing import Any

from testbed.numbers.metrics.delays import receipts, received_ms
from testbed.numbers.metrics.window import Window
from tests.handmade.attempts import called

WINDOW = Window(start_ns=0, end_ns=1_000, asked_ns=0)
FOGS = {1: [1, 2]}


def last_word(t_ns: int, number: int, drone: int) -> dict[str, Any]:
    return {"t_ns": t_ns, "event": "outcome", "call": number, "drone": drone, "word": "unconfirmed", "final": True}


def got(arrived_ns: int, command: int, *params: float) -> dict[str, Any]:
    return {"t_ns": arrived_ns, "event": "command", "command": command, "params": params, "arrived_ns": arrived_ns}


def test_each_drone_of_a_broadcast_gets_it_once() -> None:
    flights = {"uav1": [got(20, 22)], "uav2": [got(21, 22)]}
    events = [called(10, 1, "takeoff"), last_word(50, 1, 1), last_word(50, 1, 2)]
    assert receipts(events, flights, FOGS, WINDOW) == {"calls": 2, "doubled": 0, "late": 0}


def test_what_comes_again_is_doubled_and_what_comes_behind_the_last_word_is_late() -> None:
    flights = {"uav1": [got(20, 22), got(30, 22), got(60, 22)], "uav2": []}
    events = [called(10, 1, "takeoff", 1), last_word(50, 1, 1)]
    assert receipts(events, flights, FOGS, WINDOW) == {"calls": 1, "doubled": 2, "late": 1}


def test_the_same_command_called_again_is_not_doubled() -> None:
    flights = {"uav1": [got(20, 22), got(120, 22)]}
    events = [called(10, 1, "takeoff", 1), last_word(50, 1, 1), called(100, 2, "takeoff", 1)]
    assert receipts(events, flights, FOGS, WINDOW) == {"calls": 2, "doubled": 0, "late": 0}


def test_another_command_of_the_same_number_is_another() -> None:
    """Disarming is MAV_CMD 400 too."""
    flights = {"uav1": [got(20, 400, 1.0), got(60, 400, 0.0)]}
    assert receipts([called(10, 1, "arm", 1)], flights, FOGS, WINDOW) == {"calls": 1, "doubled": 0, "late": 0}


def test_where_no_autopilot_logs_commands_nothing_is_known() -> None:
    assert receipts([called(10, 1, "arm", 1)], {"uav1": [], "uav2": []}, FOGS, WINDOW) is None


def test_a_call_that_reached_nobody_is_neither() -> None:
    flights = {"uav1": [got(20, 400, 1.0)], "uav2": []}
    assert receipts([called(10, 1, "arm")], flights, FOGS, WINDOW) == {"calls": 2, "doubled": 0, "late": 0}


def test_a_call_that_was_lost_does_not_take_the_next_ones_receipt() -> None:
    flights = {"uav1": [got(2_100_000, 22)]}
    events = [called(100_000, 1, "takeoff", 1), called(2_000_000, 2, "takeoff", 1)]
    assert received_ms(events, flights, FOGS, Window(0, 3_000_000, 0)) == {"takeoff": [0.1]}
