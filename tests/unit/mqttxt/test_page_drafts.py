"""Which plans the page's editor of missions takes whole, and why it takes no others (docs/page.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mqttxt import Plan
from mqttxt.page.drafts import Draft, Waypoint, draft_of, path_of
from mqttxt.protocol.plans import PlanItem, PlanObject

PARAMS = (0.0, 0.0, 0.0, None)
TAKEOFF = PlanItem(3, 22, (15.0, 0.0, 0.0, None), 471_000_000, 81_000_000, 12.0, True)
FIRST = PlanItem(3, 16, PARAMS, 471_000_000, 82_000_000, 12.0, True)
SECOND = replace(FIRST, x=472_000_000, z=20.0)
BACK = PlanItem(2, 20, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0, True)
SPEED = PlanItem(2, 178, (1.0, 5.0, -1.0, 0.0), 0, 0, 0.0, True)


def plan(*mission: PlanItem, **lists: tuple[PlanItem, ...]) -> Plan:
    return Plan(PlanObject(mission=mission, **lists))


@pytest.mark.parametrize("takes_off", [True, False])
@pytest.mark.parametrize("returns", [True, False])
def test_what_the_editor_draws_it_takes(takes_off: bool, returns: bool) -> None:
    mission = [*[TAKEOFF] * takes_off, FIRST, SECOND, *[BACK] * returns]
    waypoints = (Waypoint(47.1, 8.2, 12.0), Waypoint(47.2, 8.2, 20.0))
    assert draft_of(plan(*mission, fence=(), rally=())) == Draft(waypoints, takes_off, returns)


@pytest.mark.parametrize(
    ("found", "why"),
    [
        (plan(), "it has no waypoint"),
        (plan(TAKEOFF, BACK), "it has no waypoint"),
        (plan(FIRST, fence=(FIRST,)), "it has a geofence"),
        (plan(FIRST, rally=(FIRST,)), "it has rally points"),
        (plan(FIRST, SPEED, SECOND), "item 2 is MAV_CMD 178, and no waypoint"),
        (plan(FIRST, TAKEOFF, SECOND), "item 2 is MAV_CMD 22, and no waypoint"),
        (plan(FIRST, BACK, SECOND), "item 2 is MAV_CMD 20, and no waypoint"),
        (plan(replace(FIRST, frame=0)), "item 1 is not above home"),
        (plan(FIRST, replace(SECOND, autocontinue=False)), "item 2 does not go on by itself"),
        (plan(replace(FIRST, params=(5.0, 0.0, 0.0, None))), "item 1 has parameters that the editor does not have"),
        (plan(replace(FIRST, params=(0.0, 0.0, 0.0, 0.0))), "item 1 has parameters that the editor does not have"),
        (plan(TAKEOFF, SECOND), "item 1 takes off to another height than the first waypoint's"),
    ],
)
def test_what_it_would_lose_something_of_it_does_not_take(found: Plan, why: str) -> None:
    assert draft_of(found) == why


def test_a_surveys_way_is_shown() -> None:
    survey = Plan.load(Path(__file__).parent / "plans" / "survey.plan")
    assert draft_of(survey) == "it has a geofence"
    assert path_of(survey) == [(47.397742, 8.545594), (47.398, 8.546), (47.398, 8.548)]
