"""What is told of a mission's progress: its end, and where it is replaced or started anew."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink.mission_progress import MissionProgress
from mqttxt.protocol.plans import PlanList
from mqttxt.protocol.states import Mission

ONE, OTHER = b"1" * 16, b"2" * 16
UP_AND_BACK = (mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
SECOND_REACHED = mavlink.MAVLink_mission_item_reached_message(1)


@pytest.fixture
def flown() -> MissionProgress:
    """Of a mission that was read, and flown to its second item."""
    progress = MissionProgress()
    progress.read(ONE, UP_AND_BACK)
    progress.begin()
    progress.on_message(SECOND_REACHED)
    return progress


def test_of_another_mission_nothing_was_reached(flown: MissionProgress) -> None:
    assert flown.is_over
    flown.forget()
    flown.read(OTHER, UP_AND_BACK)
    assert flown.states() == [Mission(0, 0, 3, OTHER)]
    flown.begin()
    assert flown.on_message(SECOND_REACHED) == [Mission(0, 0, 3, OTHER)], "PX4 repeats what it has said"
    assert not flown.is_over


def test_the_same_mission_is_as_far_as_it_was(flown: MissionProgress) -> None:
    flown.forget()
    flown.read(ONE, UP_AND_BACK)
    assert flown.states() == [Mission(0, 2, 3, ONE)]


def test_a_client_that_reads_the_mission_in_flight_keeps_what_it_heard() -> None:
    progress = MissionProgress()
    progress.on_message(SECOND_REACHED)
    progress.read(ONE, UP_AND_BACK)
    assert progress.hashes == {PlanList.MISSION: ONE}
    assert progress.reached == 2


def test_home_counts_in_the_numbers_and_not_in_the_total() -> None:
    """ArduCopter at the second of three items."""
    progress = MissionProgress(home_items=1)
    progress.on_message(mavlink.MAVLink_mission_current_message(2, 3, mavlink.MISSION_STATE_ACTIVE))
    assert progress.on_message(mavlink.MAVLink_mission_item_reached_message(2)) == [Mission(2, 2, 3, None)]
    assert not progress.is_over
    progress.on_message(mavlink.MAVLink_mission_item_reached_message(3))
    assert progress.is_over


def test_a_mission_of_one_item_ends() -> None:
    progress = MissionProgress(home_items=1)
    progress.on_message(mavlink.MAVLink_mission_current_message(1, 1, mavlink.MISSION_STATE_ACTIVE))
    progress.on_message(mavlink.MAVLink_mission_item_reached_message(1))
    assert progress.is_over


@pytest.mark.parametrize(
    ("message", "total"),
    [
        (mavlink.MAVLink_mission_current_message(1), 3),  # an older autopilot reports no total
        (mavlink.MAVLink_mission_current_message(0, 0, mavlink.MISSION_STATE_NO_MISSION), 0),
        (mavlink.MAVLink_mission_current_message(0, 0xFFFF, mavlink.MISSION_STATE_NO_MISSION), 0),
    ],
)
def test_a_total_that_is_not_reported_is_that_of_the_mission_that_was_read(message: Any, total: int) -> None:
    progress = MissionProgress()
    progress.read(ONE, UP_AND_BACK)
    progress.on_message(message)
    assert progress.total == total
