"""The live page in a real Chromium: a first flight by mouse and by keyboard, who may command, brokers that die."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from mqttxt.demo.fleet import places_file
from tests.rigs.live_page import ARMED, CONTROL, HEIGHT, NEEDS_BROWSER, REACHABLE, LivePage, cell, done, is_ready
from tests.rigs.processes import System, wait_until
from tests.rigs.served_page import Served

pytestmark = [pytest.mark.integration, NEEDS_BROWSER]
PHONE, LAPTOP, DESK = 400, 1366, 1600
ARM, TAKEOFF, LAND = 400, 22, 21
PICTURES = os.environ.get("PAGE_PICTURES")
"""Where pictures of the page go, as docs/pictures; none are made without."""


@pytest.fixture(scope="module")
def system(shared_system: System) -> System:
    return shared_system


@pytest.fixture(scope="module")
def page(system: System) -> Iterator[Served]:
    """With the demo's places, which its pictures show."""
    places = system.folder / "places.geojson"
    places.write_text(places_file())
    served = Served(system.folder, system.cloud, "page", "--places", str(places))
    yield served
    served.process.kill()


def take_picture(browser: LivePage, name: str, width: int, dark: bool = False) -> None:
    if PICTURES is not None:
        browser.picture(Path(PICTURES) / f"{name}.png", width, dark)
        browser.resize(DESK, dark=False)


def test_first_flight_by_mouse_alone(system: System, page: Served, browser: LivePage) -> None:
    browser.open(page.url, DESK)
    is_ready(browser, 1, 2)
    browser.watch_inputs()
    assert browser.value("document.querySelector('#send-arm').disabled"), "nobody is selected"
    browser.until("document.querySelectorAll('[data-marker]').length === 2", "both on the map")
    browser.click("[data-marker='1/1'] path")
    assert browser.value("document.querySelector(\"tr[data-drone='1/1'] input\").checked"), (
        "the map selects in the table"
    )
    browser.click("tr[data-drone='1/2'] th")
    browser.until(
        "document.querySelector(\"[data-marker='1/2']\").matches('.selected')", "the table selects on the map"
    )
    browser.until_text("#who", "Drone 1, 2")
    assert browser.value("document.querySelector('#send-goto').disabled"), "two drones do not go to one place"
    browser.click("#send-arm")
    done(browser, "arm to drone 1, 2", drones=2)
    browser.click("#send-takeoff")
    done(browser, "takeoff altitude 10 m to drone 1, 2", drones=2)
    browser.click("tr[data-drone='1/2'] th")
    browser.until_text("#who", "Drone 1")
    browser.click("#map", 0.8, 0.2)
    assert browser.value("document.getElementById('goto-latitude_deg').value") != "", "the map fills in the place"
    assert int(browser.value("document.getElementById('goto-altitude_m').value")) in (9, 10, 11)
    browser.click("#send-goto")
    browser.until("document.querySelectorAll('#map .goals text').length === 1", "the goal on the map")
    browser.until("document.querySelector('#orders > li:first-child .left').textContent !== ''", "time left")
    take_picture(browser, "page", DESK)
    take_picture(browser, "page-dark", DESK, dark=True)
    take_picture(browser, "page-phone", PHONE)
    take_picture(browser, "page-phone-dark", PHONE, dark=True)
    done(browser, "goto latitude")
    browser.click("#to-fog-1")
    browser.click("#send-land")
    done(browser, "land to all drones of fog 1", drones=2)
    browser.until_text(cell(1, ARMED), "no")
    assert len(system.commanded(2, TAKEOFF)) == 1
    assert browser.inputs()[1] == 0, "no key was pressed"
    assert browser.said == []


def test_a_place_for_a_drone_on_the_ground_is_as_high_as_it_will_take_off(page: Served, browser: LivePage) -> None:
    browser.open(page.url, DESK)
    is_ready(browser, 1)
    browser.click("tr[data-drone='1/1'] th")
    browser.type("#takeoff-altitude_m", "12.5")
    browser.click("#map", 0.6, 0.3)  # where no drone has landed
    assert browser.value("document.getElementById('goto-altitude_m').value") == "12.5"


def test_a_click_that_is_held_back_on_its_way_is_not_carried_out_later(
    system: System, page: Served, browser: LivePage
) -> None:
    armed = len(system.commanded(1, ARM))
    browser.open(page.url, DESK)
    is_ready(browser, 1)
    browser.click("tr[data-drone='1/1'] th")
    browser.type("#ttl", "1")
    os.kill(page.process.pid, signal.SIGSTOP)  # nothing comes through, as by a tunnel that stalls
    try:
        browser.click("#send-arm")
        browser.value("new Promise(late => setTimeout(late, 1500))")
    finally:
        os.kill(page.process.pid, signal.SIGCONT)
    browser.until_text("#notice", "not sent: it was asked for")
    assert len(system.commanded(1, ARM)) == armed


@pytest.mark.soak("services/mqttxt/src/mqttxt/page")
def test_first_flight_by_keyboard_alone(system: System, page: Served, browser: LivePage) -> None:
    flown = len(system.commanded(2, TAKEOFF))
    browser.open(page.url, DESK)
    is_ready(browser, 2)
    browser.watch_inputs()
    browser.tab_to("tr[data-drone='1/2'] input")
    browser.press(" ")
    browser.until_text("#who", "Drone 2")
    browser.tab_to("#send-arm")
    browser.press("Enter")
    done(browser, "arm to drone 2")
    browser.tab_to("#takeoff-altitude_m")
    browser.press_all("12.5")
    browser.press("Enter")
    done(browser, "takeoff altitude 12.5 m to drone 2")
    for field, text in (("latitude_deg", "47.3978"), ("longitude_deg", "8.5457"), ("altitude_m", "14.5")):
        browser.tab_to(f"#goto-{field}")
        browser.press_all(text)
    browser.press("Enter")
    done(browser, "goto latitude 47.3978000° longitude 8.5457000° altitude 14.5 m to drone 2")
    browser.tab_to("#send-goto")
    browser.press("h")
    done(browser, "hold to drone 2")
    browser.press("l")
    done(browser, "land to drone 2")
    assert len(system.commanded(2, TAKEOFF)) == flown + 1
    assert len(system.commanded(1, ARM)) <= 1, "the other drone was not commanded"
    assert browser.inputs()[0] == 0, "no button of the mouse was pressed"


def test_a_place_is_chosen_on_the_map_by_keyboard_alone(page: Served, browser: LivePage) -> None:
    browser.open(page.url)
    is_ready(browser, 1, 2)
    browser.watch_inputs()
    browser.tab_to("tr[data-drone='1/1'] input")
    browser.press(" ")
    browser.tab_to("#map")
    for _ in range(2):
        browser.press("ArrowUp", shift=True)
    browser.press("Enter")
    place = "['latitude_deg', 'longitude_deg'].map(name => Number(document.getElementById(`goto-${name}`).value))"
    north, east = browser.value(place)
    browser.press("ArrowLeft")
    browser.press("Enter")
    assert browser.value(place)[0] == north
    assert browser.value(place)[1] < east
    browser.until_text("#goto-distance", " m from drone 1")
    assert browser.value("[...document.querySelectorAll('.middle')].every(cross => cross.checkVisibility())")
    assert browser.inputs()[0] == 0, "no button of the mouse was pressed"


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [PHONE, DESK])
def test_the_page_fits_and_keeps_nobody_out(page: Served, browser: LivePage, width: int, dark: bool) -> None:
    browser.open(page.url, width, dark)
    browser.click("tr[data-drone='1/1'] input")
    browser.until_text("#who", "Drone 1")
    assert browser.value("document.documentElement.scrollWidth") == width
    assert browser.wider() == []
    browser.until_text("#rankings", "best first (QoDS)")
    for table in ("#fleet .scroll", "#rankings"):
        box = f"document.querySelector('{table}')"
        assert browser.value(f"{box}.scrollWidth <= {box}.clientWidth"), f"every value of {table} is seen"
    apart = "[...document.querySelectorAll('.field > [type=checkbox]')].filter(e => e.checkVisibility()"
    apart += " && e.getBoundingClientRect().bottom < e.labels[0].getBoundingClientRect().top).map(e => e.id)"
    assert browser.value(apart) == [], "a box stands beside its words"
    cut = "[...document.querySelectorAll('#fleet :is(th, td)')].filter(e => e.scrollWidth > e.clientWidth)"
    assert browser.value(f"{cut}.map(e => e.textContent)") == [], "no heading and no value is cut"
    assert browser.violations() == []
    assert browser.said == []


@pytest.mark.parametrize(("width", "height"), [(LAPTOP, 768), (PHONE, 700), (DESK, 1000)])
def test_what_ends_a_flight_is_in_sight_wherever_one_is(
    page: Served, browser: LivePage, width: int, height: int
) -> None:
    browser.open(page.url, width)
    browser.resize(width, dark=False, height=height)
    is_ready(browser, 1)
    browser.click("tr[data-drone='1/1'] th")
    browser.until_text("#safety-who", "Drone 1")
    for place in ("0", "document.body.scrollHeight / 2", "document.body.scrollHeight"):
        browser.value(f"scrollTo({{top: {place}, behavior: 'instant'}})")
        covered = browser.value(
            """['hold', 'land', 'return'].filter(name => { const button = document.getElementById(`send-${name}`);
              const box = button.getBoundingClientRect();
              return button.disabled || box.bottom > innerHeight || box.right > innerWidth
                || document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2) !== button; })"""
        )
        assert covered == [], place


@pytest.mark.parametrize("text", ["1,5", "", "12 m", "1e1", "-1", "10001"])
def test_what_is_no_number_within_its_limits_is_not_sent(page: Served, browser: LivePage, text: str) -> None:
    browser.open(page.url)
    is_ready(browser, 1)
    browser.click("tr[data-drone='1/1'] input")
    browser.type("#takeoff-altitude_m", text)
    sent = browser.value("document.querySelectorAll('#orders > li').length")
    browser.click("#send-takeoff")
    said = browser.value("document.getElementById('takeoff-altitude_m').validationMessage")
    assert said == "Expected a number from 0.5 to 10000, with a point before decimals, as 12.5"
    assert browser.value("document.getElementById('takeoff-altitude_m').value") == text, "a comma does not vanish"
    assert browser.value("document.querySelectorAll('#orders > li').length") == sent


def test_a_place_that_is_pasted_fills_in_both_fields_and_the_map_goes_as_far(page: Served, browser: LivePage) -> None:
    browser.open(page.url)
    is_ready(browser, 1)
    browser.click("tr[data-drone='1/1'] input")
    browser.value(
        """(() => { const clipboardData = new DataTransfer();
          clipboardData.setData('text', '(47.5, 8.5470)');
          document.getElementById('goto-latitude_deg').dispatchEvent(
            new ClipboardEvent('paste', { clipboardData, bubbles: true, cancelable: true })); })()"""
    )
    places = [browser.value(f"document.getElementById('goto-{name}_deg').value") for name in ("latitude", "longitude")]
    assert places == ["47.5", "8.5470"]
    browser.until_text("#goto-distance", " km from drone 1")
    browser.until_text("#map-scale", " km")


def test_times_are_those_of_whoever_looks_at_the_page(page: Served, browser: LivePage) -> None:
    browser.set_time_zone("Asia/Kathmandu")
    browser.open(page.url)
    browser.until("document.querySelectorAll('#log li').length > 0", "the log")
    utc, shown = browser.value("(t => [t.dateTime, t.textContent])(document.querySelector('#log time'))")
    there = datetime.fromisoformat(utc).astimezone(timezone(timedelta(hours=5, minutes=45)))
    browser.set_time_zone("")
    assert shown == there.isoformat(timespec="milliseconds")[11:23]


def test_what_rounds_to_nothing_has_no_sign(page: Served, browser: LivePage) -> None:
    browser.open(page.url)
    shown = "import('/dom.js').then(dom => [-0.04, -0.06, 0, 12.34].map(value => dom.fixed(value, 1)))"
    assert browser.value(shown) == ["0.0", "-0.1", "0.0", "12.3"]


async def test_a_page_that_only_watches_cannot_command(system: System, browser: LivePage) -> None:
    watching = Served(system.folder, system.cloud, "watching", "--watch-only")
    try:
        armed = len(system.commanded(1, ARM))
        arm = {"do": "command", "command": "arm", "parameters": {}, "to": {"drones": [[1, 1]]}}
        assert "only watches" in (await watching.ask(**arm))["error"]
        assert "only watches" in (await watching.ask(do="take_over", to={"drones": [[1, 1]]}))["error"]
        browser.open(watching.url)
        browser.until_text(cell(1, REACHABLE), "yes")
        assert not browser.value("document.getElementById('command').checkVisibility()")
        assert len(system.commanded(1, ARM)) == armed
        browser.until_text(cell(1, HEIGHT), " m")
        assert "this station" not in browser.text(cell(1, CONTROL))
    finally:
        watching.process.kill()


def test_two_pages_compete_and_both_see_who_has_control(system: System, page: Served, browser: LivePage) -> None:
    other = Served(system.folder, system.cloud, "other")
    try:
        with LivePage() as second:
            browser.open(page.url)
            is_ready(browser, 1, 2)
            second.open(other.url)
            ours, theirs = browser.text("#station"), second.text("#station")
            assert ours != theirs
            second.until_text(cell(1, CONTROL), ours)
            second.click("#select-all")
            second.click("#take-over")
            for drone in (1, 2):
                second.until_text(cell(drone, CONTROL), "this station")
                browser.until_text(cell(drone, CONTROL), theirs)
            browser.until_text("#notice", f"Control of drone 1, 2 is lost: {theirs} has it.")
            browser.click("tr[data-drone='1/1'] input")
            browser.click("#send-arm")
            browser.until_text("#orders > li:first-child", "Another ground station controls the drone")
            browser.click("#select-all")
            browser.click("#take-over")
            for drone in (1, 2):
                browser.until_text(cell(drone, CONTROL), "this station")
                second.until_text(cell(drone, CONTROL), ours)
            second.until_text("#notice", f"Control of drone 1, 2 is lost: {ours} has it.")
            browser.until("document.getElementById('notice').textContent === ''", "the loss is over")
            assert (browser.said, second.said) == ([], [])
    finally:
        other.process.kill()


def test_the_log_is_searched_and_exported(system: System, page: Served, browser: LivePage) -> None:
    browser.open(page.url)
    is_ready(browser, 1)
    browser.click("tr[data-drone='1/1'] input")
    browser.click("#send-hold")
    done(browser, "hold to drone 1")
    browser.click("#search")
    browser.value("document.execCommand('insertText', false, 'HOLD')")
    browser.until("[...document.querySelectorAll('#log li')].every(li => /hold/i.test(li.textContent))", "only those")
    lines = browser.value("fetch(document.getElementById('export').href).then(answer => answer.text())").splitlines()
    events = [json.loads(line) for line in lines]
    assert any(event["kind"] == "Outcome" and event["event"]["word"] == "completed" for event in events)
    assert all("hold" in line.lower() for line in lines)
    browser.type("#search", "remaining_pct")
    everything = "fetch(document.getElementById('export-all').href).then(answer => answer.text())"
    try:
        system.control(1, {"set": {"battery_pct": 50}})
        wait_until(lambda: '"StateUpdate"' in browser.value(everything), "a state that is no entry is exported")
    finally:
        system.control(1, {"set": {"battery_pct": 100}})


def test_another_site_is_not_let_in(page: Served, browser: LivePage) -> None:
    evil = page.process.log.parent / "evil.html"
    evil.write_text(f"<script>window.s = new WebSocket('ws://127.0.0.1:{page.port}/live')</script>")
    browser.show(evil.as_uri())
    browser.until("window.s.readyState === WebSocket.CLOSED", "another site's socket is closed")


@pytest.mark.soak("services/mqttxt/src/mqttxt/page", "services/mqttxt/src/mqttxt/station")
def test_the_cloud_broker_dies_in_flight_and_comes_back(system: System, page: Served, browser: LivePage) -> None:
    browser.open(page.url)
    is_ready(browser, 1)
    browser.click("tr[data-drone='1/1'] input")
    browser.click("#send-arm")
    done(browser, "arm to drone 1")
    browser.click("#send-takeoff")
    done(browser, "takeoff altitude 10 m to drone 1")
    system.cloud.kill()
    browser.until_text("#fogs", "NOT HEARD", 90)
    browser.until("document.querySelectorAll(\"tr[data-drone='1/1'] .stale\").length > 0", "old values look stale")
    browser.click("#send-land")
    browser.until_text("#orders > li:first-child", "not sent")
    system.cloud.start()
    browser.until_text("#fogs", "Fog 1: heard", 90)
    browser.until_text(cell(1, CONTROL), "this station", 90)
    browser.press("l")
    done(browser, "land to drone 1")


def test_the_page_of_a_system_without_what_linux_has_flies(system: System, browser: LivePage) -> None:
    as_windows = (sys.executable, "tests/rigs/other_system.py", "mqttxt")
    served = Served(system.folder, system.cloud, "windows", mqttxt=as_windows)
    try:
        browser.open(served.url)
        browser.until_text(cell(2, REACHABLE), "yes")
        browser.click("tr[data-drone='1/2'] input")
        browser.click("#take-over")
        browser.until_text(cell(2, CONTROL), "this station")
        browser.click("#send-hold")
        done(browser, "hold to drone 2")
        assert served.process.stop() == 128 + signal.SIGTERM
        assert "Traceback" not in served.process.log.read_text()
    finally:
        served.process.kill()


def test_the_page_comes_back_with_its_program(system: System, browser: LivePage) -> None:
    served = Served(system.folder, system.cloud, "again", "--watch-only")
    try:
        browser.open(served.url)
        served.process.kill()
        browser.until_text("#connection", "does not answer")
        served.process.start()
        browser.until_text("#connection", "connected")
        browser.until_text(cell(1, REACHABLE), "yes")
    finally:
        served.process.kill()
