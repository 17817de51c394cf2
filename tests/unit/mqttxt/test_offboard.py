"""Offboard: set-points streamed on the drone, begun within the deadline and ended safely (section 5)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.set_points import quaternion
from mqttxt.drone.mavlink.sources import Source
from mqttxt.protocol.commands import Attitude, Goto, Hold, Land, Offboard, Return, Velocity
from mqttxt.protocol.messages import CommandId, Word
from tests.simulation.workbench import LAND, MODE, REPOSITION, Bench, said, set_points, written
from tests.simulation.world import ack, heartbeat, home, landed, position

NORTH = Offboard(10.0, velocity=Velocity(2.0, 0.0, -0.5))
STEP_MS = 50
IN_PROGRESS = 5


def in_offboard() -> Any:
    return heartbeat(armed=True, main=6, sub=0)


def in_hold() -> Any:
    return heartbeat(armed=True, main=4, sub=3)


class Flight(Bench):
    """A drone in the air, under control; time passes in steps of a set-point."""

    def __init__(self) -> None:
        super().__init__(in_hold(), home(), position(10.0), landed(2))
        self.executor.lease.until_ms = 60_000

    def fly_until(self, now_ms: int, keep_lease: bool = True) -> list[Any]:
        out: list[Any] = []
        while self.now_ms < now_ms:
            if keep_lease:
                self.executor.lease.offboard_until_ms = self.now_ms + 3000
            out += self.until(self.now_ms + STEP_MS, STEP_MS)
        return out

    def engage(self, command: Offboard = NORTH, seq: int = 1) -> Flight:
        """The command runs and the heartbeat proves it; half a second has passed."""
        out = [*self.start(seq, command), *self.fly_until(self.now_ms + 500)]
        assert written(out) == [MODE]
        assert said(self.hear(ack(MODE), ack(MODE), in_offboard())) == [(seq, Word.ACCEPTED, None)]
        return self


@pytest.fixture
def flight() -> Flight:
    """One that has begun."""
    return Flight().engage()


def test_set_points_come_before_the_mode_and_all_within_the_deadline() -> None:
    flight = Flight()
    out = [*flight.start(1, NORTH, deadline_ms=5000), *flight.fly_until(500)]
    kinds = [o.message.get_type() for o in out if isinstance(o, Transmit)]
    assert kinds[:11] == ["SET_POSITION_TARGET_LOCAL_NED"] * 10 + ["COMMAND_LONG"]
    assert {o.not_after_ms for o in out if isinstance(o, Transmit)} == {5000}
    (mode,) = [o.message for o in out if o.message.get_type() == "COMMAND_LONG"]
    assert (mode.param1, mode.param2, mode.param3) == (1.0, 6.0, 0.0)


def test_set_points_come_at_twenty_hertz() -> None:
    flight = Flight()
    out = [*flight.start(1, NORTH), *flight.until(1000, 10)]
    assert len(set_points(out)) == 21


def test_a_tick_that_is_early_or_late_by_a_little_misses_no_set_point(flight: Flight) -> None:
    times = [500 + 50 * n + wobble for n, wobble in enumerate([0, -2, 3, -1, 9, -2, 0, -3, 1, 0], start=1)]
    assert all(len(set_points(flight.executor.tick(now_ms))) == 1 for now_ms in times)


def test_without_a_tick_for_long_there_is_no_burst_of_what_was_missed(flight: Flight) -> None:
    flight.now_ms = 2000
    assert len(set_points(flight.executor.tick(2000))) == 1
    assert set_points(flight.executor.tick(2030)) == []
    assert len(set_points(flight.executor.tick(2050))) == 1


def test_a_velocity_is_in_the_local_frame_with_everything_else_ignored() -> None:
    (out,) = Flight().start(1, Offboard(1.0, velocity=Velocity(1.0, -2.0, 0.5, yaw_deg=90.0)))
    sent = out.message
    assert (sent.target_system, sent.target_component, sent.coordinate_frame) == (1, 1, 1)
    assert (sent.vx, sent.vy, sent.vz) == (1.0, -2.0, 0.5)
    assert sent.yaw == pytest.approx(1.5708, abs=1e-4)
    assert sent.type_mask == 0b100111000111
    (unturned,) = Flight().start(1, NORTH)
    assert unturned.message.type_mask == 0b110111000111


def test_an_attitude_is_a_quaternion_with_its_thrust() -> None:
    (out,) = Flight().start(1, Offboard(1.0, attitude=Attitude(0.0, 0.0, 90.0, 0.4)))
    assert out.message.get_type() == "SET_ATTITUDE_TARGET"
    assert out.message.q == pytest.approx([0.7071, 0.0, 0.0, 0.7071], abs=1e-4)
    assert (out.message.thrust, out.message.type_mask) == (0.4, 0b111)
    assert quaternion(0.0, 30.0, 0.0) == pytest.approx([0.9659, 0.0, 0.2588, 0.0], abs=1e-4)


def test_at_the_end_of_the_duration_the_drone_holds_and_then_the_set_points_stop(flight: Flight) -> None:
    out = flight.fly_until(10_400)
    assert written(out) == []
    assert len(set_points(out)) == 198
    assert {o.not_after_ms for o in set_points(out)} == {None}
    ending = flight.fly_until(10_600)
    (hold,) = [o.message for o in ending if isinstance(o, Transmit) and o.message.get_type() == "COMMAND_LONG"]
    assert (hold.command, hold.param2, hold.param3) == (MODE, 4.0, 3.0)
    assert (set_points(ending)[-1].message.vx, set_points(ending)[-1].message.vz) == (0.0, 0.0)
    assert said(ending) == []
    assert flight.hear(ack(MODE)) == []
    assert said(flight.hear(in_hold())) == [(1, Word.COMPLETED, None)]
    assert flight.fly_until(12_000) == []


def test_hold_is_commanded_again_until_the_mode_has_changed(flight: Flight) -> None:
    out = flight.fly_until(12_000)
    assert written(out) == [MODE, MODE, MODE, MODE]


def test_set_points_stop_all_the_same_when_the_mode_does_not_change_back(flight: Flight) -> None:
    out = flight.fly_until(14_000)
    assert said(out) == [(1, Word.FAILED, "no_hold")]
    assert set_points(flight.fly_until(16_000)) == []


def test_without_a_newer_lease_it_ends_three_seconds_after_its_start(flight: Flight) -> None:
    flight.executor.lease.offboard_until_ms = None
    assert written(flight.fly_until(3000, keep_lease=False)) == []
    assert written(flight.fly_until(3050, keep_lease=False)) == [MODE]
    assert said(flight.hear(in_hold())) == [(1, Word.FAILED, "lease_lost")]


def test_an_offboard_lease_that_lapses_ends_it(flight: Flight) -> None:
    flight.fly_until(6000)
    assert flight.executor.lease.offboard_until_ms == 8950
    assert written(flight.fly_until(8950, keep_lease=False)) == []
    assert written(flight.fly_until(9000, keep_lease=False)) == [MODE]
    assert said(flight.hear(in_hold())) == [(1, Word.FAILED, "lease_lost")]


@pytest.mark.parametrize("until_ms", [None, 4000])
def test_it_ends_with_the_control_lease(until_ms: int | None, flight: Flight) -> None:
    flight.fly_until(4000)
    flight.executor.lease.until_ms = until_ms
    flight.fly_until(4050)
    assert said(flight.hear(in_hold())) == [(1, Word.FAILED, "lease_lost")]


@pytest.mark.parametrize("until_ms", [None, -1])
def test_without_control_it_does_not_begin(until_ms: int | None) -> None:
    flight = Flight()
    flight.executor.lease.until_ms = until_ms
    assert said(flight.start(1, NORTH)) == [(1, Word.DENIED, "no_lease")]


def test_it_ends_when_another_station_takes_control(flight: Flight) -> None:
    flight.fly_until(4000)
    flight.executor.lease.holder_session = 2
    assert written(flight.fly_until(4050)) == [MODE]
    assert said(flight.hear(in_hold())) == [(1, Word.FAILED, "lease_lost")]
    assert said(flight.start(2, NORTH)) == [(2, Word.DENIED, "no_lease")]


def test_a_pilots_mode_stops_the_set_points_at_once_and_nothing_is_commanded(flight: Flight) -> None:
    assert said(flight.hear(heartbeat(armed=True, main=3, sub=0))) == [(1, Word.FAILED, "mode_changed")]
    assert flight.fly_until(5000) == []


def test_a_pilots_mode_while_it_stops_is_not_overridden(flight: Flight) -> None:
    flight.fly_until(10_500)
    assert said(flight.hear(heartbeat(armed=True, main=3, sub=0))) == [(1, Word.COMPLETED, None)]
    assert flight.fly_until(13_000) == []


@pytest.mark.parametrize(
    ("newer", "number"), [(Hold(), REPOSITION), (Land(), LAND), (Goto(47.4, 8.5, 10.0), REPOSITION)]
)
def test_a_later_flight_command_takes_over_when_it_is_accepted(newer: Any, number: int, flight: Flight) -> None:
    assert written(flight.start(2, newer)) == [number]
    assert len(set_points(flight.fly_until(600))) == 2
    source = Source.HALT if isinstance(newer, Hold) else Source.COMPANION
    assert said(flight.hear(ack(number, source=source))) == [(2, Word.ACCEPTED, None), (1, Word.SUPERSEDED, None)]
    assert set_points(flight.fly_until(2000)) == []


def test_a_flight_command_that_is_refused_leaves_it_flying(flight: Flight) -> None:
    flight.start(2, Land())
    out = flight.hear(ack(LAND, 2)) + flight.fly_until(1000)
    assert said(out) == [(2, Word.DENIED, "autopilot")]
    assert len(set_points(out)) == 10


def test_a_lease_that_ends_while_a_landing_is_sent_does_not_hold_against_it(flight: Flight) -> None:
    flight.executor.lease.offboard_until_ms = None
    flight.fly_until(2900, keep_lease=False)
    flight.start(2, Land())
    assert MODE not in written(flight.fly_until(3200, keep_lease=False))
    assert said(flight.hear(ack(LAND))) == [(2, Word.ACCEPTED, None), (1, Word.FAILED, "lease_lost")]
    assert flight.fly_until(4000) == []


def test_a_newer_offboard_command_goes_on_from_the_older_without_a_gap(flight: Flight) -> None:
    out = flight.start(2, Offboard(5.0, velocity=Velocity(0.0, 3.0, 0.0)))
    assert written(out) == [MODE]
    assert set_points(flight.fly_until(550))[0].message.vx == 2.0
    assert said(flight.hear(ack(MODE), in_offboard())) == [(2, Word.ACCEPTED, None), (1, Word.SUPERSEDED, None)]
    assert set_points(flight.fly_until(650))[0].message.vy == 3.0


def test_set_points_of_somebody_else_are_not_mixed_with() -> None:
    flight = Flight()
    flight.hear(in_offboard())
    assert said(flight.start(1, NORTH)) == [(1, Word.DENIED, "offboard_elsewhere")]


def test_the_deadline_ends_what_has_not_begun() -> None:
    flight = Flight()
    out = [*flight.start(1, NORTH, deadline_ms=300), *flight.fly_until(1000)]
    assert said(out) == [(1, Word.EXPIRED, None)]
    assert written(out) == []
    assert set_points(flight.fly_until(2000)) == []


def test_the_autopilots_refusal_ends_the_set_points() -> None:
    flight = Flight()
    flight.start(1, NORTH)
    flight.fly_until(500)
    assert said(flight.refuse(ack(MODE, 1))) == [(1, Word.DENIED, "temporarily_rejected")]
    assert set_points(flight.fly_until(1000)) == []


def test_a_mode_that_was_not_acknowledged_is_left_again_before_the_last_word() -> None:
    flight = Flight()
    flight.start(1, NORTH)
    flight.fly_until(2900)
    modes = [o for o in flight.fly_until(3100) if isinstance(o, Transmit) and hasattr(o.message, "command")]
    assert [m.message.param2 for m in modes] == [4.0]
    assert said(flight.hear(in_hold())) == [(1, Word.UNCONFIRMED, "no_ack")]


def test_a_mode_that_never_shows_is_no_flight() -> None:
    flight = Flight()
    flight.start(1, NORTH)
    flight.fly_until(500)
    flight.hear(ack(MODE), in_hold())
    out: list[Any] = []
    for now_ms in range(1000, 5000, 500):
        out += [*flight.fly_until(now_ms), *flight.hear(in_hold())]
    assert said(out) == [(1, Word.FAILED, "mode_changed")]


def test_its_limit_ends_it_before_its_duration() -> None:
    flight = Flight()
    flight.start(1, NORTH, limit_ms=4000)
    flight.fly_until(500)
    flight.hear(ack(MODE), in_offboard())
    flight.fly_until(4050)
    assert said(flight.hear(in_hold())) == [(1, Word.FAILED, "timeout")]


def test_a_silent_autopilot_is_told_to_hold_and_nobody_knows(flight: Flight) -> None:
    out = [o for now_ms in range(550, 7000, 50) for o in flight.executor.tick(now_ms)]
    assert MODE in written(out)
    assert said(out) == [(1, Word.UNCONFIRMED, "autopilot_lost")]


def test_a_drone_that_is_disarmed_is_not_flown_any_more(flight: Flight) -> None:
    assert written(flight.hear(heartbeat(armed=False, main=6, sub=0))) == [MODE]
    assert said(flight.hear(heartbeat(armed=False))) == [(1, Word.FAILED, "disarmed")]


@pytest.mark.parametrize(("begun", "held"), [(lambda f: f, []), (lambda f: f.engage(), [MODE])])
def test_a_process_that_ends_leaves_the_drone_in_hold(begun: Callable[[Flight], Flight], held: list[int]) -> None:
    assert written(begun(Flight()).executor.leave(0)) == held


def test_a_process_that_ends_repeats_the_hold_and_brakes(flight: Flight) -> None:
    flight.fly_until(2000)
    assert written(flight.executor.leave(flight.now_ms)) == [MODE]
    out = flight.fly_until(2900)
    assert written(out) == [MODE]
    assert {point.message.vx for point in set_points(out)} == {0.0}


def test_a_process_that_stood_still_commands_no_hold_before_a_fresh_heartbeat(flight: Flight) -> None:
    flight.fly_until(2000)
    flight.hear(in_offboard())
    flight.now_ms = 22_000  # PX4 left offboard long ago, and a pilot may fly
    flight.executor.stood_still()
    out = flight.executor.tick(22_000)
    out += flight.hear(heartbeat(armed=True, main=3, sub=0))
    assert written(out) == []
    still = Flight().engage()
    still.fly_until(2000)
    still.now_ms = 4000
    still.executor.stood_still()
    out = still.executor.tick(4000)
    out += still.hear(in_offboard())
    assert MODE in written([*out, *still.fly_until(16_000)])


def test_a_command_after_the_flight_does_not_wait_for_acknowledgements_that_have_come(flight: Flight) -> None:
    flight.fly_until(10_500)
    flight.hear(ack(MODE), ack(MODE), in_hold())
    assert written(flight.start(2, Return())) == [MODE]


def test_a_write_that_the_link_did_not_take_is_primed_and_written_again() -> None:
    flight = Flight()
    flight.start(1, NORTH)
    flight.fly_until(450)
    flight.executor.tick(500)
    assert flight.executor.on_refused(CommandId(1, 1), False, 500) == []
    assert written(flight.fly_until(600)) == [MODE]


def test_before_its_acknowledgement_the_end_commands_no_hold_against_a_pilot() -> None:
    flight = Flight()
    flight.start(1, NORTH)
    flight.fly_until(600)
    flight.hear(heartbeat(armed=True, main=3, sub=0))
    flight.executor.lease.until_ms = 600
    out = flight.fly_until(1000)
    assert (written(out), said(out)) == ([], [(1, Word.FAILED, "lease_lost")])


def test_a_process_that_ends_holds_though_the_acknowledgement_has_not_come() -> None:
    flight = Flight()
    flight.start(1, NORTH)
    assert written(flight.fly_until(600)) == [MODE]
    out = flight.executor.leave(600)
    assert written(out) == [MODE]
    assert said(flight.hear(in_hold())) == [(1, Word.FAILED, "cancelled")]


def test_offboard_that_no_heartbeat_shows_is_not_completed() -> None:
    flight = Flight()
    flight.start(1, Offboard(1.0, velocity=Velocity(2.0, 0.0, 0.0)))
    flight.fly_until(500)
    out = flight.hear(ack(MODE), ack(MODE))
    for _ in range(8):
        out += flight.fly_until(flight.now_ms + 500) + flight.hear(in_hold())
    assert said(out) == [(1, Word.ACCEPTED, None), (1, Word.FAILED, "mode_changed")]
    assert written(out) == []


@pytest.mark.parametrize(("lease_ms", "limit_ms", "reason"), [(1000, 60_000, "lease_lost"), (60_000, 1000, "timeout")])
def test_what_ends_offboard_ends_it_while_the_autopilot_is_still_at_it(
    lease_ms: int, limit_ms: int, reason: str
) -> None:
    flight = Flight()
    flight.start(1, NORTH, limit_ms=limit_ms)
    flight.fly_until(600)
    assert said(flight.hear(ack(MODE, IN_PROGRESS, 50))) == [(1, Word.IN_PROGRESS, None)]
    flight.executor.lease.until_ms = lease_ms
    assert MODE in written(flight.fly_until(1600))
    assert said(flight.hear(ack(MODE), in_hold())) == [(1, Word.FAILED, reason)]
