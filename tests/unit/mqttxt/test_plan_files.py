"""QGroundControl's plan files: read, flattened, written back; each mistake is one line with the item's number."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from mqttxt import ConfigurationError, Plan
from mqttxt.cli.main import app
from mqttxt.errors import PayloadError, PlanMistakes
from mqttxt.protocol.plans import PlanItem, PlanObject
from mqttxt.station.plan_reading import read
from mqttxt.station.plan_writing import document_of
from tests.simulation.strategies import messages

SURVEY = Path(__file__).parent / "plans" / "survey.plan"


def test_a_survey_is_flattened_to_what_a_drone_flies() -> None:
    plan = Plan.load(SURVEY)
    assert [item.command for item in plan.content.mission or ()] == [22, 16, 206, 16, 177, 20]
    assert plan.content.mission is not None
    takeoff, corner, *_, jump, _ = plan.content.mission
    assert takeoff == PlanItem(3, 22, (15.0, 0.0, 0.0, None), 473_977_420, 85_455_940, 20.0, True)
    assert (corner.x, corner.y, corner.z) == (473_980_000, 85_460_000, 20.0)
    assert jump.params == (4.0, 2.0, 0.0, 0.0)
    assert [(item.command, item.params[0]) for item in plan.content.fence or ()] == [
        *[(5001, 4.0)] * 4,
        (5004, 25.5),
        (5000, 0.0),
    ]
    assert [(item.command, item.z) for item in plan.content.rally or ()] == [(5100, 15.0)] * 2
    assert plan.home == (47.397742, 8.545594, 488.0)


def test_what_is_written_is_the_same_plan_again(tmp_path: Path) -> None:
    plan = Plan.load(SURVEY)
    plan.save(tmp_path / "again.plan")
    again = Plan.load(tmp_path / "again.plan")
    assert again == plan
    assert again.mission_hash == plan.mission_hash
    assert str(again) == "6 mission items, 6 fence items, 2 rally points"


@pytest.mark.parametrize("frame", [0, 10])
def test_a_rally_point_above_something_else_than_home_is_not_written_as_above_home(tmp_path: Path, frame: int) -> None:
    point = PlanItem(frame, 5100, (0.0, 0.0, 0.0, 0.0), 473_977_420, 85_455_940, 502.0, False)
    with pytest.raises(PayloadError, match=rf"^rallyPoints point 1: .* above home, got MAV_FRAME {frame}$"):
        Plan(PlanObject(rally=(point,))).save(tmp_path / "wrong.plan")
    assert list(tmp_path.iterdir()) == []


@given(st.lists(messages(PlanItem), max_size=4))
def test_any_list_is_packed_and_unpacked_as_it_was(items: list[Any]) -> None:
    plan = PlanObject(mission=tuple(items))
    assert PlanObject.unpacked(plan.packed()) == plan


@pytest.mark.parametrize("jump_id", [[], {}, "3", 1.5, True, -1, 2**31])
def test_what_is_no_number_to_jump_to_is_one_line(jump_id: object) -> None:
    document = json.loads(SURVEY.read_text())
    document["mission"]["items"][0]["doJumpId"] = jump_id
    with pytest.raises(ConfigurationError, match=r"^plan: mission item 1: doJumpId: expected a whole number from 0 "):
        Plan.parse(json.dumps(document))


@pytest.mark.parametrize("jump_id", [None, 7])
def test_a_jump_to_none_or_to_one_of_two_items_is_refused(jump_id: int | None) -> None:
    document = json.loads(SURVEY.read_text())
    items = document["mission"]["items"]
    jump = next(item for item in items if item.get("command") == 177)
    jump["params"][0] = jump_id
    for item in items:
        if item["type"] == "SimpleItem":
            item["doJumpId"] = jump_id
    with pytest.raises(ConfigurationError, match=r"item 5: params\[0\]: expected the doJumpId of one item, got "):
        Plan.parse(json.dumps(document))


def test_a_list_that_is_absent_is_left_and_an_empty_one_clears() -> None:
    document = json.loads(SURVEY.read_text())
    del document["geoFence"]
    document["rallyPoints"]["points"] = []
    content, _ = read(document)
    assert (content.fence, content.rally) == (None, ())


def item(number: int) -> Callable[[Any], Any]:
    return lambda document: document["mission"]["items"][number]


def inner(number: int) -> Callable[[Any], Any]:
    return lambda document: document["mission"]["items"][1]["TransectStyleComplexItem"]["Items"][number]


MISTAKES: list[tuple[Callable[[Any], Any], str, Any, str]] = [
    (lambda d: d, "fileType", "Mission", "plan: fileType: expected 'Plan', got 'Mission'"),
    (lambda d: d, "version", 2, "plan: version: expected 1, got 2"),
    (lambda d: d, "mission", None, "mission: expected an object, got None"),
    (lambda d: d["mission"], "items", {}, "mission: items: expected a list, got {}"),
    (lambda d: d["mission"], "plannedHomePosition", [1, 2], "mission: plannedHomePosition: expected [latitude"),
    (item(0), "type", "missionItem", "mission item 1: type: expected 'SimpleItem' or 'ComplexItem', got 'missionItem'"),
    (item(0), "command", 31_999, "mission item 1: command: expected a MAV_CMD of common.xml, got 31999"),
    (item(0), "command", "22", "mission item 1: command: expected a whole number from 0 to 65535, got '22'"),
    (item(0), "frame", 8, "mission item 1: frame: expected 0 or 2 or 3 or 10, got 8"),
    (item(0), "autoContinue", 1, "mission item 1: autoContinue: expected true or false, got 1"),
    (item(0), "params", [1, 2], "mission item 1: params: expected seven, got 2"),
    (item(0), "params", [0, 0, 0, "x", 0, 0, 0], "mission item 1: params[3]: expected a number, got 'x'"),
    (item(0), "params", [0, 0, 0, 0, 91, 0, 0], "mission item 1: params[4]: expected a latitude from -90 to 90"),
    (item(0), "params", [0, 0, 0, 0, 0, None, 0], "mission item 1: params[5]: expected a longitude from -180 to 180"),
    (item(0), "params", [0, 0, 0, 0, 0, 0, None], "mission item 1: params[6]: expected a number, got None"),
    (item(0), "params", [0, 0, 0, 0, 0, 0, 1e39], "mission item 1: params[6]: expected a number, got 1e+39"),
    (item(1), "complexItemType", "StructureScan", "mission item 2: complexItemType: expected survey or CorridorScan"),
    (item(1), "TransectStyleComplexItem", {}, "mission item 2: TransectStyleComplexItem: Items: expected a list"),
    (inner(2), "frame", 1, "mission item 4 (survey): frame: expected 0 or 2 or 3 or 10, got 1"),
    (item(2), "params", [9, 1, 0, 0, 0, 0, 0], "mission item 5: params[0]: expected the doJumpId of one item, got 9"),
    (item(3), "params", [0, 0, 0, 0, 0.5, 0, 0], "mission item 6: params[4]: expected a whole number of 32 bits"),
    (lambda d: d["geoFence"], "version", 1, "geoFence: version: expected 2, got 1"),
    (
        lambda d: d["geoFence"]["polygons"][0],
        "polygon",
        [[1, 2]],
        "geoFence polygon 1: polygon: expected three",
    ),
    (
        lambda d: d["geoFence"]["polygons"][0],
        "inclusion",
        None,
        "geoFence polygon 1: inclusion: expected true",
    ),
    (
        lambda d: d["geoFence"]["circles"][0]["circle"],
        "radius",
        0,
        "geoFence circle 1: radius: expected metres",
    ),
    (
        lambda d: d["geoFence"]["circles"][0]["circle"],
        "center",
        3,
        "geoFence circle 1: center: expected [latitude,",
    ),
    (lambda d: d["rallyPoints"], "points", [[1, 2]], "rallyPoints point 1: expected [latitude, longitude, altitude]"),
]


@pytest.mark.parametrize(("part", "field", "value", "line"), MISTAKES, ids=[line for *_, line in MISTAKES])
def test_each_mistake_is_one_line(
    part: Callable[[Any], Any], field: str, value: Any, line: str, tmp_path: Path
) -> None:
    document = json.loads(SURVEY.read_text())
    part(document)[field] = value
    path = tmp_path / "wrong.plan"
    path.write_text(json.dumps(document))
    with pytest.raises(ConfigurationError) as raised:
        Plan.load(path)
    text = str(raised.value)
    assert text.startswith(f"{path}: {line}")
    assert "\n" not in text


def with_mistakes() -> Any:
    """A survey with mistakes in each of its parts, and two in one item."""
    document = json.loads(SURVEY.read_text())
    document["mission"]["plannedHomePosition"] = [91, 8, 488]
    item(0)(document).update(frame=8, command="22")
    inner(2)(document)["params"][4:6] = [91, 181]
    document["geoFence"]["polygons"][0].update(polygon=[[1, 2]], inclusion=None)
    document["rallyPoints"]["points"] = [[1, 2], [47, 8, 15], [47, "8", 15]]
    return document


ALL_MISTAKES = [
    "mission item 1: frame: expected 0 or 2 or 3 or 10, got 8",
    "mission item 1: command: expected a whole number from 0 to 65535, got '22'",
    "mission item 4 (survey): params[4]: expected a latitude from -90 to 90 degrees, got 91",
    "mission item 4 (survey): params[5]: expected a longitude from -180 to 180 degrees, got 181",
    "geoFence polygon 1: polygon: expected three corners or more, got 1",
    "geoFence polygon 1: inclusion: expected true or false, got None",
    "rallyPoints point 1: expected [latitude, longitude, altitude], got [1, 2]",
    "rallyPoints point 3: expected a longitude from -180 to 180 degrees, got '8'",
    "mission: plannedHomePosition: expected a latitude from -90 to 90 degrees, got 91",
]


def mistakes_of(document: Any) -> tuple[str, ...]:
    try:
        read(document)
    except PlanMistakes as mistakes:
        return mistakes.lines
    return ()


def test_all_mistakes_of_a_file_are_told_at_once_each_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "wrong.plan"
    path.write_text(json.dumps(with_mistakes()))
    with pytest.raises(ConfigurationError) as raised:
        Plan.load(path)
    assert raised.value.lines == tuple(f"{path}: {line}" for line in ALL_MISTAKES)
    typed = CliRunner().invoke(app, ["gs", "plan", "upload", str(path), "--drone", "1"])
    assert (typed.exit_code, typed.stdout) == (2, "")
    assert typed.stderr.splitlines() == [f"mqttxt: {path}: {line}" for line in ALL_MISTAKES]


@pytest.mark.parametrize("wrong", [{}, [], None, {"type": "ComplexItem", "complexItemType": "StructureScan"}])
def test_behind_an_item_that_cannot_be_counted_none_has_a_number(wrong: Any) -> None:
    document = json.loads(SURVEY.read_text())
    document["mission"]["items"].insert(0, wrong)
    document["mission"]["items"][1]["frame"] = 8
    (line,) = mistakes_of(document)
    assert line.startswith("mission item 1: ")


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.text(max_size=3), st.lists, max_leaves=5), st.data())
def test_whatever_is_in_the_place_of_a_value_is_read_or_named(value: Any, data: st.DataObject) -> None:
    """No mistake passes as a shorter plan: what was read has as many items as the file."""
    document = json.loads(SURVEY.read_text())
    whole, _ = read(document)
    place: Any = document
    while True:
        key = data.draw(st.sampled_from(list(place) if isinstance(place, dict) else list(range(len(place)))))
        if not isinstance(place[key], dict | list) or not place[key] or data.draw(st.booleans()):
            break
        place = place[key]
    before = place[key]
    place[key] = value
    lines = mistakes_of(document)
    assert all("expected" in line and "\n" not in line for line in lines)
    if not lines and not isinstance(before, list | dict):
        found, _ = read(document)
        assert len(found.mission or ()) == len(whole.mission or ())


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "Expecting value: line 1 column 1 (char 0); expected a plan in JSON"),
        (b"[]", "plan: expected an object, got []"),
        (b"\xff\xfe", "expected a plan in JSON, got bytes that are no UTF-8"),
        (b'{"version": NaN}', "expected a number, got NaN"),
        (b"[" * 100_000, "maximum recursion"),
    ],
)
def test_a_file_that_is_no_plan_is_one_line(content: bytes, line: str, tmp_path: Path) -> None:
    path = tmp_path / "no.plan"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError) as raised:
        Plan.load(path)
    assert str(raised.value).startswith(f"{path}: {line}")


def test_a_file_that_is_not_there_or_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="No such file or directory"):
        Plan.load(tmp_path / "none.plan")
    with pytest.raises(ConfigurationError, match="no such folder; expected a file in a folder that exists"):
        Plan.load(SURVEY).save(tmp_path / "none" / "there.plan")


def test_too_long_a_plan_is_refused_before_anything_is_sent(tmp_path: Path) -> None:
    document = json.loads(SURVEY.read_text())
    one = document["mission"]["items"][0]
    document["mission"]["items"] = [one] * 2001
    (tmp_path / "long.plan").write_text(json.dumps(document))
    with pytest.raises(ConfigurationError, match="mission: items: expected at most 2000, got 2001"):
        Plan.load(tmp_path / "long.plan")


def of_a_fence(fence: Any, items: Any = ()) -> tuple[str, ...]:
    mission = {"version": 2, "items": [*items]}
    fence = {"version": 2, "circles": [], "polygons": []} | fence
    with pytest.raises(ConfigurationError) as error:
        Plan.parse(json.dumps({"fileType": "Plan", "version": 1, "mission": mission, "geoFence": fence}))
    return error.value.lines


@pytest.mark.parametrize(
    ("fence", "where"),
    [
        ({"circles": [0] * 2001}, "geoFence: circles"),
        ({"polygons": [0] * 2001}, "geoFence: polygons"),
        ({"polygons": [{"polygon": [0] * 2001, "inclusion": True}]}, "geoFence polygon 1: polygon"),
    ],
)
def test_a_list_that_is_too_long_is_one_mistake_and_not_one_for_each_entry(fence: Any, where: str) -> None:
    """The live page reads files on the loop on which it commands."""
    assert of_a_fence(fence) == (f"plan: {where}: expected at most 2000, got 2001",)


def test_many_lists_that_are_too_long_together_have_bounded_mistakes() -> None:
    polygon = {"polygon": [0] * 1500, "inclusion": True}
    assert len(of_a_fence({"polygons": [polygon] * 100})) == 3000
    survey = {"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": {"Items": [0] * 1500}}
    lines = of_a_fence({}, [survey] * 100)
    assert lines[-1] == "plan: mission: items: expected at most 2000, got 3000"
    assert len(lines) <= 2 * 3000 + 1


def test_a_fence_that_is_no_polygon_is_not_written() -> None:
    plan = Plan.load(SURVEY).content
    with pytest.raises(PayloadError, match="corners follow each other"):
        document_of(PlanObject(fence=(plan.fence or ())[1:]), None)


def test_a_packed_plan_that_is_a_bomb_is_refused() -> None:
    import zlib

    with pytest.raises(PayloadError, match="at most 61440"):
        PlanObject.unpacked(zlib.compress(bytes(10_000_000)))
    for data in (b"", b"x" * 50, zlib.compress(b"abc"), Plan.load(SURVEY).content.packed() + b"x"):
        with pytest.raises(PayloadError):
            PlanObject.unpacked(copy.copy(data))
