"""Missions on the live page in a real Chromium: from a file, and drawn by mouse and by keyboard alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mqttxt import Plan
from tests.rigs.live_page import NEEDS_BROWSER, LivePage, done, is_ready
from tests.rigs.processes import System, wait_until
from tests.rigs.served_page import Served

pytestmark = [pytest.mark.integration, NEEDS_BROWSER]
WAYPOINT, RETURN, TAKEOFF = 16, 20, 22
METRE_DEG = 360 / 40_030_000
"""Of latitude, on the sphere that the map has."""


@pytest.fixture(scope="module")
def system(shared_system: System) -> System:
    return shared_system


def waypoints(browser: LivePage) -> list[list[str]]:
    """The table of waypoints, as it is on the page: latitude, longitude and height of each."""
    found = browser.value(
        "[...document.querySelectorAll('#draft-rows tr')].map(r => [...r.querySelectorAll('input')].map(i => i.value))"
    )
    assert isinstance(found, list)
    return found


def opened(browser: LivePage, page: Served) -> None:
    browser.open(page.url)
    is_ready(browser, 1, 2)
    browser.until("document.querySelectorAll('[data-marker]').length === 2", "both on the map")


@pytest.mark.soak("services/mqttxt/src/mqttxt/page", "services/mqttxt/src/mqttxt/station")
def test_a_mission_is_drawn_and_flown_by_mouse_alone(system: System, page: Served, browser: LivePage) -> None:
    opened(browser, page)
    browser.watch_inputs()
    browser.click("tr[data-drone='1/2'] th")
    browser.click("#draft-draw")
    browser.click("#map", 0.6, 0.45)
    browser.click("#map", 0.6, 0.6)
    browser.click("#map", 0.4, 0.6)
    assert len(waypoints(browser)) == 3
    browser.until("document.querySelectorAll('#map [data-waypoint]').length === 3", "the waypoints on the map")
    first, second, third = waypoints(browser)
    assert first[0] > second[0], "further up is further north"
    assert second[1] > third[1], "further left is further west"
    browser.drag("[data-waypoint='2'] circle", 0, 30)
    moved = waypoints(browser)
    assert (moved[0], moved[2]) == (first, third)
    assert float(moved[1][1]) == pytest.approx(float(second[1]), abs=2e-7), "digits are cut behind the seventh"
    assert moved[1][0] < second[0], "dragged to the south"
    browser.click("#draft-undo")
    assert waypoints(browser) == [first, second, third], "what was dragged is one step"
    browser.click("[aria-label='Delete waypoint 2']")
    assert waypoints(browser) == [first, third]
    browser.click("#draft-clear")
    assert waypoints(browser) == []
    browser.click("#draft-undo")
    assert waypoints(browser) == [first, third]
    browser.click("#draft-upload")
    done(browser, "upload drawn.plan (4 mission items) to drone 2")
    browser.click("#send-arm")
    done(browser, "arm to drone 2")
    browser.click("#plan-start")
    browser.until_text("#plan-progress", "of 4")
    done(browser, "start mission of drone 2")
    assert browser.inputs()[1] == 0, "no key was pressed"
    assert browser.said == []
    assert browser.violations() == []


def test_a_mission_is_drawn_and_saved_by_keyboard_alone(page: Served, browser: LivePage, tmp_path: Path) -> None:
    opened(browser, page)
    browser.keep_downloads(tmp_path)
    browser.watch_inputs()
    browser.tab_to("#draft-height")
    browser.press_all("12.5")
    browser.tab_to("#draft-add")
    browser.press("Enter")
    (first,) = waypoints(browser)
    assert first[2] == "12.5"
    assert browser.value("document.activeElement.ariaLabel") == "Move waypoint 1 by the arrow keys"
    browser.press("ArrowUp", shift=True)
    browser.press("ArrowUp")
    browser.press("ArrowLeft")
    ((latitude, longitude, _),) = waypoints(browser)
    assert float(latitude) - float(first[0]) == pytest.approx(11 * METRE_DEG, abs=2e-7)
    assert float(longitude) < float(first[1])
    browser.tab_to("#draft-1-altitude_m")
    browser.press_all("20")
    browser.tab_to("[aria-label='Delete waypoint 1']")
    assert waypoints(browser)[0][2] == "20"
    for name in ("draft-takeoff", "draft-return"):
        browser.tab_to(f"#{name}")
        browser.press(" ")
    browser.tab_to("#draft-save")
    browser.press("Enter")
    saved = tmp_path / "drawn.plan"
    wait_until(lambda: saved.exists() and saved.stat().st_size, "the file is saved")
    plan = Plan.load(saved)
    (item,) = plan.content.mission or ()
    assert (item.command, item.z) == (WAYPOINT, 20.0)
    assert (item.x, item.y) == (round(float(latitude) * 1e7), round(float(longitude) * 1e7))
    assert (plan.content.fence, plan.content.rally) == ((), ()), "QGroundControl wants all three parts"
    assert browser.inputs()[0] == 0, "no button of the mouse was pressed"
    assert browser.said == []


def test_a_saved_mission_takes_off_at_the_drone_and_returns_and_is_uploaded_again(
    page: Served, browser: LivePage, tmp_path: Path
) -> None:
    opened(browser, page)
    browser.keep_downloads(tmp_path)
    browser.click("tr[data-drone='1/1'] th")
    browser.click("#draft-draw")
    browser.click("#map", 0.7, 0.3)
    browser.click("#draft-save")
    saved = tmp_path / "drawn.plan"
    wait_until(lambda: saved.exists() and saved.stat().st_size, "the file is saved")
    plan = Plan.load(saved)
    takeoff, waypoint, back = plan.content.mission or ()
    assert [takeoff.command, waypoint.command, back.command] == [TAKEOFF, WAYPOINT, RETURN]
    assert takeoff.z == waypoint.z == 10.0
    assert (takeoff.x, takeoff.y) != (waypoint.x, waypoint.y)
    browser.choose("#plan-file", saved)
    browser.until("!document.getElementById('plan-upload').disabled", "the file is chosen")
    browser.click("#plan-upload")
    done(browser, "upload drawn.plan (3 mission items, 0 fence items, 0 rally points) to drone 1")


def test_a_wrong_number_in_a_drawn_mission_is_neither_saved_nor_uploaded(page: Served, browser: LivePage) -> None:
    opened(browser, page)
    browser.click("tr[data-drone='1/1'] th")
    sent = browser.value("document.querySelectorAll('#orders > li').length")
    browser.click("#draft-add")
    browser.type("#draft-1-latitude_deg", "91")
    browser.press("Tab")
    assert "from -90 to 90" in browser.value("document.getElementById('draft-1-latitude_deg').validationMessage")
    browser.click("#draft-upload")
    browser.click("#draft-save")
    assert browser.value("document.querySelectorAll('#orders > li').length") == sent
    browser.type("#draft-1-latitude_deg", "47.5")
    browser.click("#draft-upload")
    browser.until(f"document.querySelectorAll('#orders > li').length === {sent} + 1", "the right one is sent")


def written(folder: Path, name: str, *commands: int) -> Path:
    """A plan file with an item for each MAV_CMD, at places that follow each other to the north."""
    items = [
        {
            **{"type": "SimpleItem", "command": command, "frame": 3, "autoContinue": True},
            "params": [0, 0, 0, None, 47.3978 + number / 10_000, 8.5457, 10],
        }
        for number, command in enumerate(commands)
    ]
    mission = {"version": 2, "items": items, "plannedHomePosition": [47.3977, 8.5456, 488]}
    path = folder / name
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    return path


def test_a_file_is_drawn_changed_and_uploaded_where_the_editor_knows_all_of_it(
    page: Served, browser: LivePage, tmp_path: Path
) -> None:
    opened(browser, page)
    browser.click("tr[data-drone='1/1'] th")
    browser.click("#draft-draw")
    browser.click("#map", 0.6, 0.45)
    drawn = waypoints(browser)
    ticked = "[...document.querySelectorAll('#draft-takeoff, #draft-return')].map(box => box.checked)"
    before = browser.value(ticked)
    browser.choose("#plan-file", written(tmp_path, "three.plan", TAKEOFF, WAYPOINT, WAYPOINT))
    browser.until_text("#plan-found", "three.plan: 3 mission items. It is drawn below too, where it can be changed.")
    assert [row[0] for row in waypoints(browser)] == ["47.3979000", "47.3980000"]
    assert browser.value(ticked) == [True, False] != before
    browser.click("#draft-undo")
    assert browser.value(ticked) == before
    assert waypoints(browser) == drawn, "what was drawn before is one step back"
    browser.choose("#plan-file", written(tmp_path, "again.plan", TAKEOFF, WAYPOINT, WAYPOINT))
    browser.until_text("#plan-found", "again.plan")
    browser.type("#draft-2-altitude_m", "15")
    browser.press("Tab")
    browser.click("#draft-upload")
    done(browser, "upload drawn.plan (3 mission items) to drone 1")


def test_a_file_that_the_editor_does_not_know_is_shown_with_the_reason(
    page: Served, browser: LivePage, tmp_path: Path
) -> None:
    opened(browser, page)
    browser.choose("#plan-file", written(tmp_path, "odd.plan", WAYPOINT, 17, WAYPOINT))
    browser.until_text("#plan-found", "cannot be changed here: item 2 is MAV_CMD 17, and no waypoint.")
    assert waypoints(browser) == []
    way = "document.querySelector('#map .path').getAttribute('points').split(' ').length === 3"
    browser.until(way, "the file's way on the map")
    wrong = tmp_path / "wrong.plan"
    wrong.write_text(written(tmp_path, "two.plan", WAYPOINT, WAYPOINT).read_text().replace('"frame": 3', '"frame": 8'))
    browser.choose("#plan-file", wrong)
    browser.until_text("#notice", "wrong.plan: mission item 1: frame: expected 0 or 2 or 3 or 10, got 8")
    browser.until_text("#notice", "wrong.plan: mission item 2: frame: expected 0 or 2 or 3 or 10, got 8")
    assert browser.value("document.getElementById('plan-found').textContent") == ""


def test_a_plan_is_uploaded_and_its_progress_shown(page: Served, browser: LivePage, tmp_path: Path) -> None:
    path = written(tmp_path, "two.plan", WAYPOINT, WAYPOINT)
    opened(browser, page)
    browser.until_text("#rankings", "Fog 1, best first (QoDS)")
    browser.click("tr[data-drone='1/2'] input")
    assert browser.value("document.getElementById('plan-upload').disabled"), "no file is chosen"
    browser.choose("#plan-file", path)
    browser.until("!document.getElementById('plan-upload').disabled", "the file is chosen")
    browser.click("#plan-upload")
    done(browser, "upload two.plan (2 mission items) to drone 2")
    browser.until_text("#plan-progress", "Drone 2: item")
    browser.until_text("#plan-progress", "of 2")
    way = "document.querySelector('#map .path').getAttribute('points').split(' ').length === 2"
    browser.until(way, "the plan's way on the map")
