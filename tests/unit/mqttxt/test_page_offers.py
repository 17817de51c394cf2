"""What the live page offers, and how its requests are read: every mistake is one line (docs/page.md)."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mqttxt import Arm, ConfigurationError, Goto, Hold, Takeoff
from mqttxt.page.offers import (
    OFFERED,
    CommandRequest,
    LinkRequest,
    MissionRequest,
    Request,
    TakeOverRequest,
    Target,
    catalogue,
    read_request,
)
from tests.examples import examples

NOW_MS = 100_000


def request(**more: Any) -> str:
    first: dict[str, Any] = {
        "number": 3,
        "do": "command",
        "command": "arm",
        "to": {"drones": [[1, 2]]},
        "at_ms": NOW_MS,
    }
    return json.dumps(first | more)


def test_nothing_that_stops_motors_or_is_forced_is_offered() -> None:
    assert list(OFFERED) == ["arm", "takeoff", "goto", "hold", "land", "return", "pause"]


def test_the_catalogue_has_units_and_limits_of_the_specification() -> None:
    (altitude,) = catalogue()["takeoff"]["parameters"]
    assert altitude == {
        **{"name": "altitude_m", "label": "Height", "unit": "metres above home"},
        **{"low": 0.5, "high": 10_000, "default": 10.0},
    }
    places = catalogue()["goto"]["parameters"]
    assert [(p["unit"], p["low"], p["high"], p["default"]) for p in places[:2]] == [
        ("degrees", -90, 90, None),
        ("degrees", -180, 180, None),
    ]
    assert [name for name, offer in catalogue().items() if offer["each"]] == ["goto"]
    assert [name for name, offer in catalogue().items() if offer["best"]] == ["goto"]


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        (request(), CommandRequest(Arm(), Target(drones=(("", 1, 2),)), 5.0)),
        (
            request(to={"fogs": [1, 2, 1]}, command="hold", ttl_s=2),
            CommandRequest(Hold(), Target(fogs=(("", 1), ("", 2))), 2.0),
        ),
        (
            request(command="takeoff", parameters={"altitude_m": 20}),
            CommandRequest(Takeoff(20.0), Target(drones=(("", 1, 2),)), 5.0),
        ),
        (
            request(
                command="goto",
                parameters={"latitude_deg": 47, "longitude_deg": 8.5, "altitude_m": 10},
                to={"best": [1]},
            ),
            CommandRequest(Goto(47.0, 8.5, 10.0), Target(fogs=(("", 1),), best=True), 5.0),
        ),
        (
            request(to={"drones": [["acme/1", 2], ["north/eu/1", 2]]}),
            CommandRequest(Arm(), Target(drones=(("acme", 1, 2), ("north/eu", 1, 2))), 5.0),
        ),
        (request(do="start"), MissionRequest(("", 1, 2), resume=False)),
        (request(do="resume"), MissionRequest(("", 1, 2), resume=True)),
        (request(do="take_over", to={"drones": [[1, 2], [1, 3]]}), TakeOverRequest((("", 1, 2), ("", 1, 3)))),
        (
            request(do="link", link="air:uav3", figures={"loss": "20%"}, closed=True),
            LinkRequest("air:uav3", {"loss": "20%"}, closed=True),
        ),
        (request(do="link", link="air:uav3", back=True), LinkRequest("air:uav3", {}, back=True)),
    ],
)
def test_a_request_is_read(asked: str, expected: Request | LinkRequest) -> None:
    assert read_request(asked, NOW_MS) == (3, expected)


@pytest.mark.parametrize(("at_ms", "left_s"), [(NOW_MS - 4000, 1.0), (NOW_MS - 4999, 0.001), (NOW_MS + 50, 5.0)])
@pytest.mark.parametrize("do", ["command", "start", "resume"])
def test_what_was_held_back_on_its_way_has_less_time_by_that(do: str, at_ms: float, left_s: float) -> None:
    _, found = read_request(request(do=do, at_ms=at_ms), NOW_MS)
    assert isinstance(found, CommandRequest | MissionRequest)
    assert found.ttl_s == pytest.approx(left_s)


@pytest.mark.parametrize("do", ["command", "start", "resume", "take_over"])
@pytest.mark.parametrize(
    ("at_ms", "says"),
    [
        (
            NOW_MS - 17_300,
            "not sent: it was asked for 17.3 s before it came to the page's program; expected less than 5",
        ),
        (NOW_MS + 1000, "at_ms 101000: expected a number from 0 to 100100"),
        (None, "at_ms None: expected a number"),
    ],
)
def test_what_comes_too_late_or_does_not_say_when_it_was_asked_for_is_not_sent(
    do: str, at_ms: float | None, says: str
) -> None:
    with pytest.raises(ConfigurationError, match=says):
        read_request(request(do=do, at_ms=at_ms), NOW_MS)


PLACE = {"latitude_deg": 47, "longitude_deg": 8, "altitude_m": 10}


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("{", "request: expected JSON"),
        ("[" * 100_000, "request: expected JSON"),
        ("7", "request: expected an object, got int"),
        (request(to={"fogs": ["acme"]}), "to fog acme: expected a whole number from 1 to"),
        (request(to={"fogs": ["/1"]}), "to fog /1: expected a whole number"),
        (request(to={"drones": [["#/1", 1]]}), "topic prefix '#'"),
        (request(number="1"), "number '1': expected a whole number"),
        (request(do="disarm"), "do 'disarm': expected command, take_over, upload, look, start, resume or link"),
        (request(do="start", to={"drones": [[1, 1], [1, 2]]}), "start mission: expected one drone"),
        (request(do="start", to={"fogs": [1]}), "start mission: expected one drone"),
        (request(do="upload", name="", text="{}"), "name '': expected 1 to 100 characters"),
        (request(do="upload", name="a.plan", text=7), "text 7: expected the text of a .plan file"),
        (request(do="upload", name="a.plan", text="["), "a.plan: "),
        (request(do="upload", name="a.plan", text="{}"), "a.plan: plan"),
        (request(command="disarm"), "command 'disarm': expected one of arm, takeoff"),
        (request(command=["arm"]), "command ['arm']: expected one of"),
        (request(parameters={"force": 1}), "arm parameters: expected none"),
        (request(command="takeoff"), "takeoff parameters: expected altitude_m"),
        (request(command="takeoff", parameters={"altitude_m": 0}), "takeoff altitude_m 0: expected a number from 0.5"),
        (request(command="takeoff", parameters={"altitude_m": None}), "takeoff altitude_m None: expected a number"),
        (request(command="takeoff", parameters={"altitude_m": True}), "takeoff altitude_m True: expected a number"),
        (
            '{"number":1,"do":"command","command":"takeoff","to":{"drones":[[1,1]]},"parameters":{"altitude_m":NaN}}',
            "nan",
        ),
        (request(command="goto", parameters=PLACE, to={"fogs": [1]}), "goto: expected one drone"),
        (request(command="goto", parameters=PLACE, to={"drones": [[1, 1], [1, 2]]}), "goto: expected one drone"),
        (request(to={"best": [1]}), "arm: expected goto to whoever arrives first"),
        (request(to={}), "to: expected one of drones, fogs, best"),
        (request(to={"fogs": [1], "drones": [[1, 1]]}), "to: expected one of"),
        (request(to={"drones": []}), "to drones: expected a list of 1 to 250"),
        (request(to={"drones": [1]}), "to drones: expected pairs"),
        (request(to={"drones": [[1, 251]]}), "to drone 251: expected a whole number from 1 to 250"),
        (request(ttl_s=61), "ttl_s 61: expected a number from 0.1 to 60"),
        (request(ttl_s=10**400), "ttl_s"),
        (request(do="take_over", to={"fogs": [1]}), "to: expected drones to take control of"),
        (request(command="x" * 1000), "..."),
        (request(do="link"), "link None: expected 1 to 100 characters"),
        (request(do="link", link="a", figures={"queue": "1"}), "figures {'queue': '1'}: expected texts of rate, delay"),
        (request(do="link", link="a", figures={"loss": 0.2}), "figures {'loss': 0.2}: expected texts of rate, delay"),
        (request(do="link", link="a", figures=["loss"]), "figures ['loss']: expected texts"),
        (request(do="link", link="a", closed=1), "closed 1, back False: expected true or false"),
    ],
)
def test_a_wrong_request_is_refused_by_name(asked: str, says: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        read_request(asked, NOW_MS)
    assert says in str(refused.value)
    assert len(str(refused.value)) < 200


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
)


FIELDS = ["number", "do", "command", "parameters", "to", "ttl_s", "at_ms", "link", "figures", "closed", "back"]


@given(st.dictionaries(st.sampled_from(FIELDS), JSON | st.just("link")))
@examples(300)
def test_arbitrary_requests_are_read_or_refused(found: dict[str, Any]) -> None:
    try:
        number, _ = read_request(json.dumps({"number": 1, "do": "command", "command": "arm"} | found), NOW_MS)
    except ConfigurationError:
        return
    assert number >= 1
