"""The live page in a real Chromium before a made-up fleet: hostile texts, a flood of events, a large fleet."""

from __future__ import annotations

import asyncio

import pytest

from mqttxt import (
    AutopilotText,
    Battery,
    Candidate,
    CommandId,
    ConfigurationError,
    ControlChanged,
    Event,
    PsmiList,
    SensorReading,
    Severity,
    StateUpdate,
    Word,
)
from mqttxt.page.history import MOST_CHARTS
from tests.rigs.live_page import NEEDS_BROWSER, LivePage
from tests.rigs.made_up_page import served, shown
from tests.rigs.processes import eventually, free_port
from tests.simulation.page_fleet import FakeLinks, FakeStation, outcome

pytestmark = [pytest.mark.integration, NEEDS_BROWSER]
ATTACK = "<img src=x onerror=alert(1)><script>alert(2)</script>"
FLOOD = 20_000
LARGE = 250
LOADED = """document.documentElement !== null
  && getComputedStyle(document.documentElement).getPropertyValue('--ink') !== ''
  && document.querySelectorAll('#fleet-rows tr').length === 2"""


async def test_texts_of_others_are_only_text() -> None:
    station = FakeStation()
    async with shown(station) as browser:
        await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] input")
        await asyncio.to_thread(browser.click, "#send-arm")
        await eventually(lambda: station.sent, "the command")
        drone = station.the_fog.drone(1)
        drone.holder, drone.is_controlled = ATTACK, False
        station.sent[0][1].words.put_nowait(outcome(Word.FAILED, reason=ATTACK))
        events: list[Event] = [
            StateUpdate(1, 1, AutopilotText(Severity.WARNING, ATTACK), 1, 5),
            ControlChanged(1, 1, ATTACK, False, 2),
            SensorReading(1, 1, 7, 1, 1, ATTACK, 20.5, ATTACK, 1000),
            PsmiList(1, CommandId(7, 1), (), (Candidate(drone=1, reason=ATTACK),), None),
        ]
        for event in events:
            await station.heard.put(event)
        for place in ("#orders", "#log", "#notice", "#fleet-rows", "#sensors", "#rankings"):
            await asyncio.to_thread(browser.until_text, place, ATTACK)
        injected = "document.querySelectorAll('body img, body script').length"
        assert await asyncio.to_thread(browser.value, injected) == 0
        assert browser.said == []


async def test_a_sensor_that_makes_up_kinds_fills_no_browser() -> None:
    station = FakeStation()
    async with shown(station) as browser:
        for first in range(0, 3 * MOST_CHARTS, 100):
            for number in range(first, first + 100):
                await station.heard.put(SensorReading(1, 1, 7, 1, 1, f"kind{number}", 20.5, "", 1000))
            await asyncio.to_thread(browser.until_text, "#sensors", f"kind{first + 99}")
        assert await asyncio.to_thread(browser.value, "document.querySelectorAll('#sensors li').length") == MOST_CHARTS


@pytest.mark.parametrize("width", [400, 1400, 1600])
async def test_every_figure_of_a_choice_is_seen(width: int) -> None:
    station = FakeStation()
    figures = {"max_groundspeed_m_s": 12.5, "remaining_pct": 88, "range_m": 12_345.0, "age_s": 1.5}
    listed = Candidate(drone=1, distance_m=1234.0, arrival_s=98.7, **figures)
    left_out = Candidate(drone=2, reason="busy: the drone is reserved for another choice", distance_m=9876.0)
    async with shown(station) as browser:
        await station.heard.put(PsmiList(1, CommandId(7, 1), (listed,), (left_out,), 1))
        await asyncio.to_thread(browser.until_text, "#rankings", "98.7 s")
        for text in ("1234 m", "12.5 m/s", "88 %", "12345 m", "1.5 s", "busy with another choice"):
            assert text in await asyncio.to_thread(browser.text, "#rankings")
        await asyncio.to_thread(browser.resize, width, False)
        box = "document.querySelector('#rankings')"
        assert await asyncio.to_thread(browser.value, f"{box}.scrollWidth <= {box}.clientWidth")
        assert await asyncio.to_thread(browser.violations) == []


async def test_a_flood_of_events_leaves_the_page_answering() -> None:
    station = FakeStation()
    async with shown(station) as browser:
        for number in range(FLOOD):
            station.heard.put_nowait(StateUpdate(1, 1, AutopilotText(Severity.INFO, f"text {number}"), 1, 5))
        await asyncio.to_thread(browser.until_text, "#log li:first-child", f"text {FLOOD - 1}")
        assert await asyncio.to_thread(browser.value, "document.querySelectorAll('#log li').length") == 200
        await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] input")
        await asyncio.to_thread(browser.press, "h")
        await eventually(lambda: station.sent, "the command")


async def test_a_large_fleet_is_shown_whole_and_kept_current() -> None:
    station = FakeStation(LARGE)
    async with shown(station) as browser:
        rows = "document.querySelectorAll('#fleet-rows tr').length"
        markers = f"document.querySelectorAll('[data-marker]').length === {LARGE}"
        assert await asyncio.to_thread(browser.value, rows) == LARGE
        await asyncio.to_thread(browser.until, markers, "every drone on the map")
        for charge in (80, 70):
            for drone in station.the_fog.drones:
                drone.set(Battery(charge))
                station.heard.put_nowait(StateUpdate(1, drone.number, Battery(charge), 1, 5))
            current = f"[...document.querySelectorAll('#fleet-rows tr')].every(r => /{charge} %/.test(r.textContent))"
            await asyncio.to_thread(browser.until, current, f"{charge} % everywhere")
        assert browser.said == []


async def test_links_are_shown_changed_by_sliders_and_keep_nobody_out() -> None:
    links = FakeLinks()
    async with shown(FakeStation(), links) as browser:
        row = "tr[data-link='air:uav1']"
        await asyncio.to_thread(browser.until_text, row, "12/s, 5678 B/s")
        assert "20000 kbit/s, 25 ms, 1 % lost" in await asyncio.to_thread(browser.text, row)
        assert "cut" in await asyncio.to_thread(browser.text, row)
        assert await asyncio.to_thread(browser.text, "#links-title") == "Links, as MQTT-XT uses them"
        assert await asyncio.to_thread(browser.violations) == []
        await asyncio.to_thread(browser.click, "#link-air-uav1-delay")
        await eventually(lambda: links.told, "a slider was moved")
        ((name, figures, closed),) = links.told
        assert (name, closed, list(figures)) == ("air:uav1", False, ["delay"])
        assert 1000 < links.delay_ms < 2000, "in its middle"
        await asyncio.to_thread(browser.until_text, row, f", {links.delay_ms:g} ms, 1 % lost")
        links.error = ConfigurationError("air:uav1:up: links are not shaped in this run")
        await asyncio.to_thread(browser.tab_to, "#link-air-uav1-cut")
        await asyncio.to_thread(browser.press, " ")
        await asyncio.to_thread(browser.until_text, "#notice", "links are not shaped in this run")
        await asyncio.to_thread(browser.tab_to, "#link-air-uav1-back")
        await asyncio.to_thread(browser.press, "Enter")
        await eventually(lambda: links.told[1:] == [("air:uav1", {}, True), "air:uav1"], "cut, and taken back")
        for width in (400, 1600):
            await asyncio.to_thread(browser.resize, width, False)
            assert await asyncio.to_thread(browser.wider) == []
        assert browser.said == []


async def test_a_page_without_links_shows_none() -> None:
    async with shown(FakeStation()) as browser:
        assert not await asyncio.to_thread(browser.value, "document.getElementById('links-section').checkVisibility()")


@pytest.mark.parametrize("name", ["commands.js", "main.js", "page.css"])
async def test_a_page_whose_file_was_cut_off_loads_again_by_itself(name: str) -> None:
    """Chromium cuts off what it loads whenever a network interface comes or goes, as those of containers do."""
    async with served(FakeStation(), free_port()) as url:
        with LivePage() as browser:
            await asyncio.to_thread(browser.cut_off, name)
            await asyncio.to_thread(browser.show, url)
            assert await asyncio.to_thread(browser.value, LOADED) is False
            await asyncio.to_thread(browser.cut_off)
            await asyncio.to_thread(browser.until, LOADED, "the page in its colours, and its drones")
