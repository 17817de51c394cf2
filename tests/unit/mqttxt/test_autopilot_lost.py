"""An autopilot that falls silent, or starts anew, while it carries out a command (R5.26)."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink.vehicle import LOST_MS
from mqttxt.protocol.commands import Arm, Command, Goto, Land, Return, Stream
from mqttxt.protocol.messages import Word
from tests.simulation.workbench import ARM, LAND, MODE, REPOSITION, Bench, said, written
from tests.simulation.world import ack, from_autopilot, heartbeat, home, landed, position

GROUND, AIR = 1, 2
IN_LAND = {"main": 4, "sub": 6}
LOST = [(1, Word.UNCONFIRMED, "autopilot_lost")]
RESTARTED = [(1, Word.UNCONFIRMED, "autopilot_restarted")]
RUNNING: list[tuple[Command, int]] = [(Goto(47.4, 8.5, 10.0), REPOSITION), (Land(), LAND), (Return(), MODE)]


def since_start(boot_ms: int) -> Any:
    return from_autopilot(mavlink.MAVLink_system_time_message(0, boot_ms))


def flying(command: Command, number: int) -> Bench:
    """A drone in the air that carries out a command, its autopilot started ten minutes ago."""
    bench = Bench(heartbeat(armed=True), home(), position(10.0), landed(AIR), since_start(600_000))
    bench.start(1, command, limit_ms=900_000)
    assert said(bench.hear(ack(number)))[0] == (1, Word.ACCEPTED, None)
    return bench


def silence(bench: Bench, until_ms: int) -> list[Any]:
    """Let time pass without a word of the autopilot."""
    out: list[Any] = []
    while bench.now_ms < until_ms:
        bench.now_ms += 100
        out += bench.executor.tick(bench.now_ms)
    return out


@pytest.mark.parametrize(("command", "number"), RUNNING)
def test_what_runs_ends_ten_seconds_after_the_last_heartbeat(command: Command, number: int) -> None:
    bench = flying(command, number)
    assert silence(bench, LOST_MS) == []
    assert said(silence(bench, LOST_MS + 100)) == LOST


def test_a_gap_of_heartbeats_does_not_end_what_goes_on() -> None:
    bench = flying(Land(), LAND)
    for start_ms in range(0, 100_000, 10_000):
        bench.now_ms = start_ms + 1000
        assert bench.hear(heartbeat(armed=True, **IN_LAND), since_start(600_000 + bench.now_ms)) == []
        assert silence(bench, start_ms + 10_000) == []
    down = (heartbeat(**IN_LAND), landed(GROUND), since_start(700_000))
    assert said(bench.hear(*down)) == [(1, Word.COMPLETED, None)]


def test_what_is_in_progress_ends_too_and_its_number_rests() -> None:
    bench = Bench()
    bench.start(1, Arm(), limit_ms=900_000)
    bench.hear(ack(ARM, 5, 40))
    assert said(silence(bench, LOST_MS + 100)) == LOST
    bench.hear(heartbeat(armed=True))
    assert written(bench.start(2, Arm())) == []


def test_a_stream_of_an_autopilot_that_was_lost_is_over() -> None:
    bench = Bench()
    bench.start(1, Stream("mavlink/ATTITUDE", 0.1), limit_ms=60_000)
    bench.hear(ack(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL))
    assert said(silence(bench, LOST_MS + 100)) == LOST
    assert not bench.executor.streams.names


@pytest.mark.parametrize(("command", "number"), RUNNING)
@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 1, 0)])
@pytest.mark.parametrize("silent_ms", [300, 2000])
def test_an_autopilot_that_starts_anew_completes_and_fails_nothing(
    command: Command, number: int, order: tuple[int, ...], silent_ms: int
) -> None:
    """PX4 says at first that it is disarmed and on the ground, wherever it is."""
    bench = flying(command, number)
    bench.hear(heartbeat(armed=True, main=4, sub={LAND: 6, MODE: 5, REPOSITION: 3}[number]))
    silence(bench, silent_ms)
    first = (heartbeat(armed=False), landed(GROUND), since_start(1500))
    out = bench.hear(*(first[index] for index in order))
    assert said(out) == RESTARTED


def test_after_a_silence_nothing_is_said_until_the_time_since_the_start_came() -> None:
    bench = flying(Land(), LAND)
    bench.hear(heartbeat(armed=True, **IN_LAND))
    silence(bench, 3000)
    assert said(bench.hear(heartbeat(**IN_LAND), landed(GROUND))) == []
    assert said(bench.hear(since_start(603_000))) == [(1, Word.COMPLETED, None)]


def test_heartbeats_alone_after_a_silence_are_nobodys() -> None:
    """They may be of another start: for ten seconds after the last heartbeat before that can come out."""
    bench = flying(Land(), LAND)
    silence(bench, 3000)
    out: list[Any] = []
    for now_ms in range(4000, LOST_MS + 3000, 1000):
        out += bench.hear(heartbeat(armed=True, **IN_LAND)) + silence(bench, now_ms)
    assert said(out) == LOST


def test_at_its_limit_after_a_silence_nobody_knows() -> None:
    bench = Bench()
    bench.start(1, Land(), limit_ms=5000)
    bench.hear(ack(LAND))
    silence(bench, 4000)
    bench.hear(heartbeat(armed=True, **IN_LAND))
    assert said(silence(bench, 5000)) == LOST


def test_messages_that_overtake_each_other_are_no_new_start() -> None:
    bench = flying(Land(), LAND)
    assert bench.hear(since_start(600_900), since_start(600_100), heartbeat(armed=True, **IN_LAND)) == []


def test_a_command_of_the_new_start_is_not_ended_by_it() -> None:
    bench = flying(Land(), LAND)
    silence(bench, 2000)
    assert said(bench.hear(since_start(1500))) == RESTARTED
    bench.hear(heartbeat(), landed(GROUND))
    assert written(bench.start(2, Arm())) == [ARM]
    assert said(bench.hear(ack(ARM), heartbeat(armed=True)))[-1] == (2, Word.COMPLETED, None)
