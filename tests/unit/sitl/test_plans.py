"""The stand-in keeps and flies plans: what recordings do not show of it."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.plans import FENCE, MISSION, Item, Partner

TO: Partner = (1, 1)
WAYPOINT, TAKEOFF, LAND = mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_NAV_LAND
METRE_1E7 = 1e7 / 111_195


def place(drone: Any, command: int, north_m: float, up_m: float, *params: float) -> Item:
    home = drone.autopilot.guidance.home
    four = [*params, *[0.0] * (4 - len(params))]
    x, y = round(home.latitude_deg * 1e7 + north_m * METRE_1E7), round(home.longitude_deg * 1e7)
    return Item(3, command, (four[0], four[1], four[2], four[3]), x, y, up_m)


def plain(command: int, *params: float) -> Item:
    four = [*params, *[0.0] * (4 - len(params))]
    return Item(2, command, (four[0], four[1], four[2], four[3]), 0, 0, 0.0)


def upload(drone: Any, items: list[Item], kind: int = MISSION) -> Any:
    """The last answer."""
    (answer,) = drone.tell(mavlink.MAVLink_mission_count_message(*TO, len(items), kind))
    while answer.get_type().startswith("MISSION_REQUEST"):
        (answer,) = drone.tell(items[answer.seq].message(TO, answer.seq, kind, answer.seq == 0))[:1]
    return answer


def fly(drone: Any, items: list[Item], start: int, *params: float) -> None:
    assert upload(drone, items).type == mavlink.MAV_MISSION_ACCEPTED
    assert drone.command(400, 1) == 0
    assert drone.command(start, *params) == 0


def test_there_is_no_plan_at_first(drone: Any) -> None:
    (answer,) = drone.tell(mavlink.MAVLink_mission_request_list_message(*TO))
    assert (answer.get_type(), answer.count) == ("MISSION_COUNT", 0)


def test_items_are_repeated_and_the_last_one_is_told(drone: Any) -> None:
    up, there = place(drone, TAKEOFF, 0, 10), place(drone, WAYPOINT, 20, 10)
    fly(drone, [up, there, plain(mavlink.MAV_CMD_DO_JUMP, 1, 2), plain(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 3, -1)], 300)
    drone.fly_until(lambda: drone.mode == "HOLD")
    reached = [message.seq for message in drone.sent("MISSION_ITEM_REACHED")]
    assert reached == [0, 2, 3]  # of several that are over at once the last
    assert drone.events().count("item_reached") == 3
    assert drone.autopilot.motion.position[0] == pytest.approx(20, abs=3)


def test_a_px4s_takeoff_elsewhere_climbs_and_then_flies_there(drone: Any) -> None:
    fly(drone, [place(drone, TAKEOFF, 40, 10), place(drone, mavlink.MAV_CMD_NAV_LOITER_UNLIM, 40, 10)], 300)
    drone.fly_until(lambda: drone.up_m > 8)
    assert drone.autopilot.motion.position[0] == pytest.approx(0, abs=1)
    drone.fly_until(lambda: drone.events().count("item_reached") == 1)
    assert drone.autopilot.motion.position[0] == pytest.approx(40, abs=11)


def test_an_item_that_stays_is_never_over(drone: Any) -> None:
    fly(drone, [place(drone, TAKEOFF, 0, 10), place(drone, mavlink.MAV_CMD_NAV_LOITER_UNLIM, 10, 10)], 300)
    drone.fly(120)
    assert drone.mode == "MISSION"
    assert drone.autopilot.motion.position[0] == pytest.approx(10, abs=1)


def test_px4_arms_for_a_mission_and_a_copter_does_not(drone: Any, copter: Any) -> None:
    assert upload(drone, [place(drone, TAKEOFF, 0, 10)]).type == 0
    assert drone.command(300, 5) == mavlink.MAV_RESULT_DENIED
    assert drone.command(300) == 0
    assert drone.autopilot.armed
    home = place(copter, WAYPOINT, 0, 0)
    assert upload(copter, [home, place(copter, TAKEOFF, 0, 10)]).type == 0
    assert copter.command(300) == 0
    assert (copter.mode, copter.autopilot.armed) == ("AUTO", False)


def test_a_copters_mission_waits_on_the_ground_and_lands(copter: Any) -> None:
    items = [place(copter, WAYPOINT, 0, 0), place(copter, TAKEOFF, 0, 8), place(copter, LAND, 0, 0)]
    fly(copter, items, 176, 1, 3)
    copter.fly(5)
    assert copter.up_m == 0
    assert copter.command(300) == 0
    copter.fly_until(lambda: not copter.autopilot.armed)
    assert copter.mode == "AUTO"
    assert [message.seq for message in copter.sent("MISSION_ITEM_REACHED")] == [1, 2]


def test_a_copters_home_counts_in_the_numbers_of_its_items_and_not_in_their_total(copter: Any) -> None:
    def told() -> tuple[int, int, int]:
        copter.fly(1.5)
        seen = copter.vehicle.streamed(0, copter.autopilot.now_s)
        message = [each for each in seen if each.get_type() == "MISSION_CURRENT"][-1]
        return message.seq, message.total, message.mission_state

    copter.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, 1e6)
    assert told() == (0, 0, mavlink.MISSION_STATE_NO_MISSION)
    upload(copter, [place(copter, WAYPOINT, 0, 0), *[place(copter, WAYPOINT, north_m, 8) for north_m in (10, 20, 30)]])
    (answer,) = copter.tell(mavlink.MAVLink_mission_set_current_message(*TO, 3))
    assert (answer.seq, answer.total) == (3, 3)
    assert told() == (3, 3, mavlink.MISSION_STATE_NOT_STARTED)


def test_only_one_uploads_at_a_time(drone: Any, copter: Any) -> None:
    for one, refused in ((drone, mavlink.MAV_MISSION_ERROR), (copter, mavlink.MAV_MISSION_DENIED)):
        one.tell(mavlink.MAVLink_mission_count_message(*TO, 2, MISSION))
        packed = mavlink.MAVLink_mission_count_message(*TO, 1, MISSION).pack(mavlink.MAVLink(None, 7, 190))
        (answer,) = [o.message for o in one.vehicle.handle(0, mavlink.MAVLink(None).parse_buffer(packed)[0])]
        assert (answer.get_type(), answer.type) == ("MISSION_ACK", refused)


def test_a_request_is_repeated_on_the_link_that_uploads(drone: Any) -> None:
    drone.tell(mavlink.MAVLink_mission_count_message(*TO, 2, FENCE))
    drone.fly(0.3)
    asked = [m for m in drone.vehicle.streamed(0, 0.3) if m.get_type() == "MISSION_REQUEST_INT"]
    assert [(m.seq, m.mission_type, m.target_system) for m in asked] == [(0, FENCE, 245)]
    drone.fly(6)
    assert not [m for m in drone.vehicle.streamed(0, 6.3) if m.get_type() == "MISSION_REQUEST_INT"]
    assert "Operation timeout\t" in [o.message.text for o in drone.vehicle.advance(6.5) if hasattr(o, "message")]


@pytest.mark.parametrize("count", [0, 1])
def test_a_copter_refuses_a_list_of_no_known_kind(copter: Any, count: int) -> None:
    (answer,) = copter.tell(mavlink.MAVLink_mission_count_message(*TO, count, 5))
    assert (answer.get_type(), answer.type) == ("MISSION_ACK", mavlink.MAV_MISSION_UNSUPPORTED)
