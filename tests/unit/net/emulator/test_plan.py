"""A plan is read whole or refused in one line that names file, field, value and what was expected."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from net.emulator.plan import PlanError, Settings, changed, parse_plan, read_plan
from net.link_plan import EventPlan

UP, DOWN = "air:uav1:up", "air:uav1:down"
LINK = f"f: links.{UP}"
RATE = "expected a whole number from 1000 to 100000000000"
SHARED = "expected a rate_bps on both: it is what they share"
PARTNER = "expected another link, which shares with no third one"


def plan(**top: Any) -> dict[str, Any]:
    return {"version": 1, "profile": "p", "seed": 1, "links": {UP: {}, DOWN: {}}, "events": [], **top}


def with_link(**link: Any) -> dict[str, Any]:
    return plan(links={UP: link, DOWN: {"rate_bps": 64_000}})


def with_event(**event: Any) -> dict[str, Any]:
    return plan(events=[{"at_s": 20.0, "link": UP, "for_s": 5.0, "change": {"closed": True}, **event}])


def test_every_field_of_a_link_is_read() -> None:
    given = {
        "rate_bps": 64_000, "queue_packets": 60, "delay_us": 40_000, "jitter_us": 20_000, "distribution": "pareto",
        "reordering": True, "loss": 0.01, "duplicate": 0.02, "corrupt": 0.03, "reorder": 0.04,
        "shared_with": DOWN,
    }  # fmt: skip
    assert parse_plan(with_link(**given), "f").links[UP] == Settings(**given)


def test_events_are_in_the_order_of_their_times() -> None:
    events = [
        {"at_s": 9, "link": UP, "for_s": 1, "change": {"loss": 0.2}},
        {"at_s": 2.5, "link": DOWN, "for_s": 0.5, "change": {"closed": True}},
    ]
    found = parse_plan(plan(events=events), "f").events
    assert found == (EventPlan(2.5, DOWN, 0.5, {"closed": True}), EventPlan(9.0, UP, 1.0, {"loss": 0.2}))
    assert changed(Settings(loss=0.1, delay_us=5), found[1].change) == Settings(loss=0.2, delay_us=5)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ([], "f []: expected an object"),
        (plan(version=2), "f: version 2: expected 1"),
        (plan(profile=None), "f: profile None: expected a name"),
        (plan(seed=-1), "f: seed -1: expected a whole number from 0 to 18446744073709551615"),
        (plan(seed=True), "f: seed True: expected a whole number from 0 to 18446744073709551615"),
        (plan(links={}), "f: links {}: expected at least one"),
        (plan(extra=1), "f: unknown field 'extra'; expected version, profile, seed, links, events"),
        (with_link(rate_bps=-5), f"{LINK}.rate_bps -5: {RATE}"),
        (with_link(rate_bps=1.5), f"{LINK}.rate_bps 1.5: {RATE}"),
        (with_link(delay_us="25ms"), f"{LINK}.delay_us '25ms': expected a whole number from 0 to 60000000"),
        (with_link(loss=1.2), f"{LINK}.loss 1.2: expected a share from 0 to 1"),
        (with_link(loss=float("nan")), f"{LINK}.loss nan: expected a share from 0 to 1"),
        (with_link(reordering=1), f"{LINK}.reordering 1: expected true or false"),
        (with_link(distribution="x"), f"{LINK}.distribution 'x': expected one of normal, uniform, pareto"),
        (with_link(queue_packets=9), f"{LINK}.queue_packets 9: expected null without a rate_bps: nothing waits"),
        (with_link(reorder=0.1), f"{LINK}.reorder 0.1: expected 0 without a delay_us, which a frame skips"),
        (with_link(jitter_us=2, delay_us=1), f"{LINK}.jitter_us 2: expected at most delay_us, 1"),
        (with_link(shared_with="x"), f"{LINK}.shared_with 'x': {PARTNER}"),
        (with_link(shared_with=UP, rate_bps=1000), f"{LINK}.shared_with '{UP}': {PARTNER}"),
        (with_link(shared_with=DOWN), f"{LINK}.shared_with '{DOWN}': {SHARED}"),
        (with_event(link="air:uav9:up"), "f: events[0].link 'air:uav9:up': expected one of air:uav1:up, air:uav1:down"),
        (with_event(link=["x"]), "f: events[0].link ['x']: expected one of air:uav1:up, air:uav1:down"),
        (with_event(at_s=-1), "f: events[0].at_s -1: expected seconds from 0 to 86400"),
        (with_event(for_s=0), "f: events[0].for_s 0: expected more than 0"),
        (with_event(change={}), "f: events[0].change {}: expected at least one field of a link"),
        (with_event(change={"loss": 2}), "f: events[0].change.loss 2: expected a share from 0 to 1"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(data: object, said: str) -> None:
    with pytest.raises(PlanError) as error:
        parse_plan(data, "f")
    assert str(error.value) == said


def test_a_file_that_is_no_plan_is_named(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    with pytest.raises(PlanError, match=r"plan\.json: No such file or directory; expected a plan in JSON$"):
        read_plan(path)
    path.write_text("{")
    with pytest.raises(PlanError, match=r"plan\.json: Expecting property name .*; expected a plan in JSON$"):
        read_plan(path)
    path.write_text(json.dumps(plan()))
    assert read_plan(path).links[UP] == Settings()
