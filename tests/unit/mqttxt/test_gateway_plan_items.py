"""A plan's items as clients send them: as the plan has them, or refused with the item's number (docs/gateway.md)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from mqttxt import Home
from mqttxt.gateway.modes import ARDUPILOT, PX4
from mqttxt.gateway.plan_items import (
    WrongItem,
    check_count,
    client_list,
    home_items,
    item_from,
    item_message,
    plan_list,
)
from mqttxt.protocol.plans import PlanItem, PlanList
from tests.examples import examples
from tests.unit.mqttxt.test_gateway_translation import view

NAN, INF = float("nan"), float("inf")
X, Y = 473_977_420, 85_455_940
INT_RELATIVE, INT_ABSOLUTE, NO_PLACE, TERRAIN = 6, 5, 2, 11
INCLUSION, EXCLUSION, CIRCLE, BACK, RALLY = 5001, 5002, 5003, 5000, 5100


def sent(message: Any) -> Any:
    """A message as it arrives."""
    return mavlink.MAVLink(None).decode(bytearray(message.pack(mavlink.MAVLink(None, 255, 190))))


def item_int(
    command: int = 16,
    frame: int = INT_RELATIVE,
    params: tuple[float, ...] = (0, 0, 0, 0),
    x: int = X,
    y: int = Y,
    z: float = 20.0,
    kind: int = 0,
    seq: int = 0,
) -> Any:
    return sent(mavlink.MAVLink_mission_item_int_message(1, 1, seq, frame, command, 0, 1, *params, x, y, z, kind))


def test_an_item_is_the_plans_with_its_plain_frame() -> None:
    found = item_from(item_int(params=(1, NAN, 0, NAN)), PlanList.MISSION, 1)
    assert found == PlanItem(3, 16, (1.0, None, 0.0, None), X, Y, 20.0, True)
    assert item_from(item_int(20, NO_PLACE, x=0, y=0, z=NAN), PlanList.MISSION, 1).z is None


def test_an_old_clients_item_has_its_place_in_degrees() -> None:
    old = mavlink.MAVLink_mission_item_message(1, 1, 0, 3, 16, 0, 1, 0, 0, 0, 0, 47.397742, 8.545594, 20.0, 0)
    found = item_from(sent(old), PlanList.MISSION, 1)
    assert found.frame == 3
    assert (found.x, found.y) == (pytest.approx(X, abs=40), pytest.approx(Y, abs=10))


@pytest.mark.parametrize(
    ("message", "kind", "result", "text"),
    [
        (item_int(frame=1), 0, "UNSUPPORTED_FRAME", "frame: expected a global frame or MAV_FRAME_MISSION, got 1"),
        (item_int(command=31_999), 0, "UNSUPPORTED", "command: expected a MAV_CMD of common.xml, got 31999"),
        (item_int(params=(INF, 0, 0, 0)), 0, "INVALID_PARAM1", "param1: expected a number or NaN, got inf"),
        (item_int(params=(0, 0, 0, -INF)), 0, "INVALID_PARAM4", "param4: expected a number or NaN, got -inf"),
        (item_int(x=910_000_000), 0, "INVALID_PARAM5_X", "latitude: expected -90 to 90 degrees, got 91"),
        (item_int(y=-1_810_000_000), 0, "INVALID_PARAM6_Y", "longitude: expected -180 to 180 degrees, got -181"),
        (item_int(z=NAN), 0, "INVALID_PARAM7", "altitude: expected metres, got nan"),
        (item_int(z=INF, frame=NO_PLACE), 0, "INVALID_PARAM7", "altitude: expected metres, got inf"),
        (item_int(kind=1), 1, "UNSUPPORTED", "command: expected a MAV_CMD of a fence list, got 16"),
        (item_int(INCLUSION, NO_PLACE, kind=1), 1, "UNSUPPORTED_FRAME", "frame: expected a global frame, got 2"),
        (item_int(INCLUSION, kind=2), 2, "UNSUPPORTED", "command: expected a MAV_CMD of a rally list, got 5001"),
        (
            sent(mavlink.MAVLink_mission_item_message(1, 1, 0, 3, 16, 0, 1, 0, 0, 0, 0, NAN, 8.5, 20.0, 0)),
            *(0, "INVALID_PARAM5_X", "latitude: expected -90 to 90 degrees, got nan"),
        ),
        (
            sent(mavlink.MAVLink_mission_item_message(1, 1, 0, 2, 20, 0, 1, 0, 0, 0, 0, 0, INF, 20.0, 0)),
            *(0, "INVALID_PARAM6_Y", "param6: expected a whole number of 32 bits, got inf"),
        ),
    ],
)
def test_what_is_wrong_with_an_item_is_named_by_its_number(message: Any, kind: int, result: str, text: str) -> None:
    with pytest.raises(WrongItem) as wrong:
        item_from(message, PlanList(kind), 7)
    assert wrong.value.result == getattr(mavlink, f"MAV_MISSION_{result}")
    assert str(wrong.value) == f"{PlanList(kind).label} item 7: {text}"


def corner(count: float, command: int = INCLUSION) -> PlanItem:
    return PlanItem(0, command, (count, 0.0, 0.0, 0.0), X, Y, 0.0, False)


@pytest.mark.parametrize(
    ("items", "text"),
    [
        ([corner(4)] * 3, "fence item 4: polygon: expected one of 4 corners that follow each other, got the end"),
        ([corner(3), corner(3), corner(4)], "fence item 3: polygon: expected one of 3 corners"),
        ([corner(3), corner(3), corner(3, EXCLUSION)], "fence item 3: polygon"),
        ([corner(3)] * 3 + [corner(2)] * 2, "fence item 4: corners: expected 3 or more in param1, got 2"),
        ([corner(3.5)] * 4, "fence item 1: corners"),
        ([corner(-1, CIRCLE)], "fence item 1: radius: expected metres above 0, got -1"),
        ([replace(corner(0), params=(None, 0.0, 0.0, 0.0))], "fence item 1: corners"),
    ],
)
def test_a_fence_whose_corners_are_no_polygon_is_refused(items: list[PlanItem], text: str) -> None:
    with pytest.raises(WrongItem, match=text.replace(".", r"\.")):
        plan_list(tuple(items), PlanList.FENCE, 0)


def test_a_fence_of_several_shapes_is_taken() -> None:
    items = (*[corner(3)] * 3, corner(25.5, CIRCLE), *[corner(4, EXCLUSION)] * 4, corner(0, BACK))
    assert plan_list(items, PlanList.FENCE, 0) == items


def test_jumps_lead_to_the_plans_item_and_back_to_the_clients() -> None:
    point, home = item_from(item_int(), PlanList.MISSION, 1), Home(47.0, 8.0, 488.0)
    for autopilot, target in ((PX4, 0.0), (ARDUPILOT, 1.0)):
        known = view(home, autopilot=autopilot)
        before = home_items(PlanList.MISSION, known)
        jump = PlanItem(2, 177, (target, 3.0, 0.0, 0.0), 0, 0, 0.0, True)
        items = plan_list((point, jump), PlanList.MISSION, before)
        assert items[1].params[0] == 1.0
        back = client_list(items, PlanList.MISSION, known)
        assert back[before:] == (point, jump)
        assert [(one.x, one.y, one.z) for one in back[:before]] == [(470_000_000, 80_000_000, 488.0)] * before
    for target in (-1.0, 0.0, 3.0, 1.5, None):
        jump = PlanItem(2, 177, (target, 3.0, 0.0, 0.0), 0, 0, 0.0, True)
        with pytest.raises(WrongItem, match="mission item 2: DO_JUMP: expected an item from 1 to 2"):
            plan_list((point, jump), PlanList.MISSION, 1)


def test_a_list_has_room_for_so_many() -> None:
    check_count(2000, PlanList.MISSION)
    with pytest.raises(WrongItem, match="mission: expected at most 2000 items, got 2001") as wrong:
        check_count(2001, PlanList.MISSION)
    assert wrong.value.result == mavlink.MAV_MISSION_NO_SPACE


def test_an_empty_mission_has_no_home_in_front() -> None:
    assert client_list((), PlanList.MISSION, view(autopilot=ARDUPILOT)) == ()


float_32 = st.floats(width=32, allow_infinity=False)
places = st.builds(
    PlanItem,
    frame=st.sampled_from([0, 3, 10]),
    command=st.sampled_from([16, 22, 21, 82]),
    params=st.tuples(*[float_32] * 4),
    x=st.integers(-900_000_000, 900_000_000),
    y=st.integers(-1_800_000_000, 1_800_000_000),
    z=st.floats(width=32, allow_infinity=False, allow_nan=False),
    autocontinue=st.booleans(),
)


@examples(200)
@given(places)
def test_what_a_client_reads_and_sends_again_is_the_same(item: PlanItem) -> None:
    assert item_from(sent(item_message(item, (1, 1), 3, PlanList.MISSION, as_int=True)), PlanList.MISSION, 4) == item
    old = sent(item_message(item, (1, 1), 3, PlanList.MISSION, as_int=False))
    again = item_from(old, PlanList.MISSION, 4)
    assert replace(again, x=0, y=0) == replace(item, x=0, y=0)
    assert (again.x, again.y) == (pytest.approx(item.x, abs=40), pytest.approx(item.y, abs=80))
