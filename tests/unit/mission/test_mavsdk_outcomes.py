"""What MAVSDK says, in MQTT-XT's words; what shows an effect; and two vehicles told from one by their heartbeats."""

from __future__ import annotations

from dataclasses import replace

import pytest
from mavsdk.plugins.action import ActionResult
from mavsdk.plugins.mission_raw import MissionRawResult
from mavsdk.plugins.offboard import OffboardResult
from mavsdk.plugins.telemetry import FlightMode, LandedState

from mission.fleet import Point, Status
from mission.mavsdk_outcomes import (
    DronePosition,
    Goal,
    HeartbeatCount,
    TimedValue,
    View,
    arm_goal,
    goto_goal,
    land_goal,
    landed_of,
    mode_of,
    refusal,
    return_goal,
    takeoff_goal,
)
from mqttxt import FlightModeName, Landed, Word

RESULTS: tuple[type[ActionResult] | type[MissionRawResult] | type[OffboardResult], ...] = (
    ActionResult,
    MissionRawResult,
    OffboardResult,
)
ASKED_S = 100.0
LATER = ASKED_S + 1


def at(altitude_m: float, when_s: float = LATER) -> TimedValue[DronePosition]:
    return TimedValue(DronePosition(47.0, 8.0, 488.0 + altitude_m, altitude_m), when_s)


def view(tells_landed: bool = True, **told: TimedValue[object]) -> View:
    return replace(View(tells_landed), **told)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("result", "word", "reason"),
    [
        (ActionResult.COMMAND_DENIED, Word.DENIED, "autopilot"),
        (ActionResult.TIMEOUT, Word.UNCONFIRMED, "timeout"),
        (ActionResult.NO_SYSTEM, Word.UNREACHABLE, "no_system"),
        (ActionResult.UNSUPPORTED, Word.UNSUPPORTED, None),
        (ActionResult.FAILED, Word.FAILED, "autopilot"),
        (MissionRawResult.DENIED, Word.DENIED, "autopilot"),
        (OffboardResult.NO_SETPOINT_SET, Word.FAILED, "no_setpoint_set"),
        (ActionResult.NO_VTOL_TRANSITION_SUPPORT, Word.FAILED, "no_vtol_transition_support"),
    ],
)
def test_a_refusal_in_mqttxts_words(
    result: ActionResult | MissionRawResult | OffboardResult, word: Word, reason: str | None
) -> None:
    assert refusal(result) == (word, reason)


@pytest.mark.parametrize(
    "result", [result for kind in RESULTS for result in kind if result.name not in ("SUCCESS", "NEXT")]
)
def test_every_refusal_is_a_last_word(result: ActionResult | MissionRawResult | OffboardResult) -> None:
    assert refusal(result)[0].is_last
    assert refusal(result)[0] is not Word.COMPLETED


def test_modes_and_landed_states_have_mqttxts_names() -> None:
    assert mode_of(FlightMode.RETURN_TO_LAUNCH) is FlightModeName.RETURN
    assert mode_of(FlightMode.RATTITUDE) is FlightModeName.UNKNOWN
    assert {landed_of(state) for state in LandedState} == set(Landed)
    named = {mode_of(mode) for mode in FlightMode} - {FlightModeName.UNKNOWN}
    assert len(named) == len(FlightMode) - 3, "all but UNKNOWN, READY and RATTITUDE, each another one"


def test_armed_counts_when_it_is_told_after_the_call() -> None:
    goal = arm_goal()
    assert not goal.reached(view(), ASKED_S)
    assert not goal.reached(view(armed=TimedValue(True, ASKED_S - 1)), ASKED_S)
    assert not goal.reached(view(armed=TimedValue(False, LATER)), ASKED_S)
    assert goal.reached(view(armed=TimedValue(True, LATER)), ASKED_S)


@pytest.mark.parametrize(
    ("target_m", "altitude_m", "reached"),
    [(10, 9.4, False), (10, 9.5, True), (3, 2.5, True), (3, 2.4, False), (40, 38, True), (40, 37.9, False)],
)
def test_a_takeoff_is_completed_half_a_metre_or_five_percent_below_its_altitude(
    target_m: float, altitude_m: float, reached: bool
) -> None:
    flying = view(place=at(altitude_m), landed=TimedValue(Landed.IN_AIR, LATER))
    assert takeoff_goal(target_m).reached(flying, ASKED_S) is reached


def test_a_takeoff_needs_the_air_where_the_streams_tell_it() -> None:
    goal = takeoff_goal(10)
    assert not goal.reached(view(place=at(10)), ASKED_S)
    assert not goal.reached(view(place=at(10), landed=TimedValue(Landed.TAKEOFF, LATER)), ASKED_S)
    assert not goal.reached(view(place=at(10, ASKED_S - 1), landed=TimedValue(Landed.IN_AIR, LATER)), ASKED_S)
    assert goal.reached(view(tells_landed=False, place=at(10)), ASKED_S)


@pytest.mark.parametrize("goal", [land_goal(), return_goal()], ids=["landing", "return"])
def test_a_landing_and_a_return_are_completed_on_the_ground_and_disarmed(goal: Goal) -> None:
    ground, disarmed = TimedValue(Landed.ON_GROUND, LATER), TimedValue(False, LATER)
    assert goal.reached(view(armed=disarmed, landed=ground), ASKED_S)
    assert not goal.reached(view(armed=TimedValue(True, LATER), landed=ground), ASKED_S)
    assert not goal.reached(view(armed=disarmed, landed=TimedValue(Landed.LANDING, LATER)), ASKED_S)
    assert goal.reached(view(tells_landed=False, armed=disarmed), ASKED_S)


@pytest.mark.parametrize(
    ("north_m", "altitude_m", "reached"),
    [(1.9, 10.9, True), (2.1, 10.0, False), (0.0, 11.1, False), (-1.9, 9.1, True)],
)
def test_a_drone_has_arrived_within_two_metres_across_and_one_in_height(
    north_m: float, altitude_m: float, reached: bool
) -> None:
    there = TimedValue(DronePosition(47.0 + north_m / 111_195, 8.0, 488.0 + altitude_m, altitude_m), LATER)
    goal = goto_goal(Point(47.0, 8.0, 10.0))
    assert goal.reached(view(place=there), ASKED_S) is reached
    assert not goal.reached(view(place=replace(there, at_s=ASKED_S - 1)), ASKED_S), "told before it was asked"


def test_a_return_ends_with_a_landing_and_with_nothing_else() -> None:
    goal = return_goal()
    landing, hold = TimedValue(FlightModeName.LAND, LATER), TimedValue(FlightModeName.HOLD, LATER)
    assert goal.failure(view(mode=landing), ASKED_S, entered=True) is None, "it ends with a landing"
    assert goal.failure(view(mode=hold), ASKED_S, entered=True) == "mode_changed"


def test_homes_height_is_what_the_two_altitudes_of_a_place_differ_by() -> None:
    assert view(place=at(4.5)).home_amsl_m == 488.0


def test_what_can_no_longer_succeed_has_failed() -> None:
    takeoff, land = takeoff_goal(10), land_goal()
    hold, position = TimedValue(FlightModeName.HOLD, LATER), TimedValue(FlightModeName.POSITION, LATER)
    assert takeoff.failure(view(armed=TimedValue(False, LATER)), ASKED_S, entered=True) == "disarmed"
    assert land.failure(view(armed=TimedValue(False, LATER)), ASKED_S, entered=True) is None
    assert takeoff.failure(view(mode=hold), ASKED_S, entered=True) is None, "hold follows a takeoff"
    assert land.failure(view(mode=hold), ASKED_S, entered=True) == "mode_changed"
    assert takeoff.failure(view(mode=position), ASKED_S, entered=True) == "mode_changed"
    assert takeoff.failure(view(mode=position), ASKED_S, entered=False) is None, "its own mode may still come"
    assert takeoff.failure(view(mode=TimedValue(FlightModeName.POSITION, 99)), ASKED_S, entered=True) is None, (
        "told before"
    )


def test_a_view_as_a_status_and_what_it_lacks() -> None:
    assert view().status == Status()
    assert view().missing == ["armed", "flight_mode", "location", "landed_state"]
    assert view(tells_landed=False).missing == ["armed", "flight_mode", "location"]
    told = view(
        armed=TimedValue(True, 1),
        mode=TimedValue(FlightModeName.TAKEOFF, 1),
        place=at(4.5),
        landed=TimedValue(Landed.TAKEOFF, 1),
    )
    assert told.missing == []
    assert told.status == Status(armed=True, mode="takeoff", altitude_m=4.5, landed="takeoff")


def count(times_s: list[float]) -> HeartbeatCount:
    found = HeartbeatCount()
    for time_s in sorted(times_s):
        found.heard(time_s)
    return found


def test_one_vehicle_sends_a_heartbeat_a_second() -> None:
    assert not count([0, 1, 2, 3]).is_one, "too early to know"
    assert count([0, 1, 2, 3, 4]).is_one
    assert count([0, 1.9, 2, 2.1, 4.5]).is_one, "late ones"


def test_two_vehicles_send_twice_as_many() -> None:
    both = [float(second) for second in range(10)]
    found = count(both + [second + 0.3 for second in both])
    assert found.is_two
    assert not found.is_one


def test_a_queue_that_empties_is_not_a_second_vehicle() -> None:
    found = count([0.1 * late for late in range(8)] + [float(second) for second in range(1, 10)])
    assert found.is_one
    assert not found.is_two


def test_two_vehicles_are_told_although_some_of_their_heartbeats_are_lost() -> None:
    both = [second + phase for second in range(12) for phase in (0.0, 0.4)]
    assert count([time_s for number, time_s in enumerate(both) if number % 10 != 9]).is_two
