"""The surveys of scenario 5: a hundred items each, above the drone's own point, the same over every protocol."""

from __future__ import annotations

import math
from itertools import pairwise

from mission.mavsdk_calls import items_of
from mission.mqttxt_fleet import plan_of
from mission.points import points_of
from mission.surveys import surveys_of
from mqttxt.protocol.commands import haversine_m
from mqttxt.protocol.plans import PlanObject

NAV_TAKEOFF, NAV_WAYPOINT, NAV_RETURN = 22, 16, 20


def test_a_survey_has_a_hundred_items_near_its_drones_point() -> None:
    for drone, survey in surveys_of(range(1, 7)).items():
        (point,) = points_of([drone]).values()
        away = [
            haversine_m(one.latitude_deg, one.longitude_deg, point.latitude_deg, point.longitude_deg)
            for one in survey.points
        ]
        steps = [
            haversine_m(one.latitude_deg, one.longitude_deg, other.latitude_deg, other.longitude_deg)
            for one, other in pairwise(survey.points)
        ]
        assert max(away) < 50
        assert 2.9 < min(steps) <= max(steps) < 4.1
        mission = plan_of(survey).content.mission
        assert mission is not None
        assert [item.command for item in mission] == [NAV_TAKEOFF, *[NAV_WAYPOINT] * 98, NAV_RETURN]


def test_over_every_protocol_it_is_the_same_mission() -> None:
    survey = surveys_of([1])[1]
    mission = plan_of(survey).content.mission
    assert mission is not None
    items = items_of(survey)
    assert [item.seq for item in items] == list(range(100))
    assert [item.current for item in items] == [1, *[0] * 99]
    assert [(item.command, item.x, item.y, item.z) for item in items] == [
        (item.command, item.x, item.y, item.z) for item in mission
    ]
    assert [math.isnan(item.param4) for item in items] == [item.params[3] is None for item in mission]
    assert PlanObject.unpacked(plan_of(survey).content.packed()).mission == mission
