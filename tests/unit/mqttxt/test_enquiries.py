"""What the UAV client asks of an autopilot that does not stream as PX4's onboard set does."""

from __future__ import annotations

from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.enquiries import Enquiries
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.protocol.plans import PlanList
from tests.simulation.world import from_autopilot, heartbeat, home, landed, position


def _asked(enquiries: Enquiries, vehicle: Vehicle, now_ms: int) -> set[object]:
    """What is asked for now: message ids of rates and requests, names of parameters."""
    vehicle.heartbeat_ms = now_ms
    found: set[object] = set()
    for question in enquiries.due(now_ms):
        assert (question.target_system, question.target_component) == (1, 1)
        name = getattr(question, "param_id", None)
        found.add(int(question.param1) if name is None else name)
    return found


def test_a_silent_autopilot_is_asked_for_nothing() -> None:
    assert Enquiries(Vehicle(1)).due(10_000) == []


def test_parameters_and_home_are_asked_for_at_once_and_the_rest_if_it_does_not_come_by_itself() -> None:
    vehicle = Vehicle(1)
    vehicle.update(heartbeat(), 0)
    enquiries = Enquiries(vehicle)
    at_once = {"MPC_XY_VEL_MAX", "MPC_XY_CRUISE", mavlink.MAVLINK_MSG_ID_HOME_POSITION}
    assert _asked(enquiries, vehicle, 0) == at_once
    vehicle.update(position(), 100)
    vehicle.update(landed(1), 100)
    asked = _asked(enquiries, vehicle, 4000)
    assert asked == at_once | {
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_VFR_HUD,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    }


def test_what_has_come_is_not_asked_for_again_and_pauses_grow() -> None:
    vehicle = Vehicle(1)
    vehicle.update(heartbeat(), 0)
    enquiries = Enquiries(vehicle)
    home_id = mavlink.MAVLINK_MSG_ID_HOME_POSITION
    times = [now for now in range(0, 60_000, 500) if home_id in _asked(enquiries, vehicle, now)]
    gaps = [later - earlier for earlier, later in pairwise(times)]
    assert times[0] == 0
    assert gaps[:5] == [1000, 2000, 5000, 10_000, 30_000]
    vehicle.update(home(), 60_000)
    assert home_id not in _asked(enquiries, vehicle, 69_000)


def _streaming(vehicle: Vehicle, now_ms: int) -> None:
    told = (
        mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [0] * 10, 0, 0, 0, 90),
        mavlink.MAVLink_vfr_hud_message(*[0] * 6),
    )
    status = mavlink.MAVLink_sys_status_message(*[0] * 13)
    for message in (heartbeat(), home(), position(), landed(1), *map(from_autopilot, (*told, status))):
        vehicle.update(message, now_ms)


def test_what_stops_coming_is_asked_for_again() -> None:
    vehicle = Vehicle(1)
    enquiries = Enquiries(vehicle)
    for now_ms in range(0, 20_000, 1000):
        _streaming(vehicle, now_ms)
        assert not {name for name in _asked(enquiries, vehicle, now_ms) if isinstance(name, int)}
    assert not {name for name in _asked(enquiries, vehicle, 28_000) if isinstance(name, int)}
    asked = _asked(enquiries, vehicle, 30_000)
    assert {mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, mavlink.MAVLINK_MSG_ID_HOME_POSITION} < asked


def test_an_autopilot_that_was_away_is_asked_for_what_it_does_not_send_any_more() -> None:
    vehicle = Vehicle(1)
    enquiries = Enquiries(vehicle)
    for now_ms in range(0, 5000, 1000):
        _streaming(vehicle, now_ms)
        enquiries.due(now_ms)
    assert enquiries.due(8000) == [], "silent for more than three seconds"
    _asked(enquiries, vehicle, 9000)
    vehicle.update(landed(1), 10_000)
    asked = _asked(enquiries, vehicle, 12_000)
    assert mavlink.MAVLINK_MSG_ID_SYS_STATUS in asked
    assert mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE not in asked


@pytest.mark.parametrize(("kind", "tells_of_fence"), [(12, False), (mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, True)])
def test_the_progress_of_a_plan_is_asked_for_once_the_plan_was_read(kind: int, tells_of_fence: bool) -> None:
    vehicle = Vehicle(1)
    vehicle.update(heartbeat(kind=kind), 0)
    enquiries = Enquiries(vehicle)
    progress = {mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, mavlink.MAVLINK_MSG_ID_FENCE_STATUS}
    _asked(enquiries, vehicle, 0)
    assert not _asked(enquiries, vehicle, 4000) & progress
    vehicle.mission.hashes.update(dict.fromkeys(PlanList, bytes(16)))
    wanted = progress if tells_of_fence else {mavlink.MAVLINK_MSG_ID_MISSION_CURRENT}
    assert _asked(enquiries, vehicle, 5000) & progress == wanted
