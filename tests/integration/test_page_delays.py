"""The live page in a real Chromium where updates come late, or its program comes back as another one."""

from __future__ import annotations

import asyncio

import pytest

from mqttxt import Battery, Location, StateUpdate
from mqttxt.page import live
from mqttxt.station.views import STALE_MS
from tests.rigs.live_page import NEEDS_BROWSER, LivePage
from tests.rigs.made_up_page import served, shown
from tests.rigs.processes import eventually, free_port
from tests.simulation.page_fleet import FakeStation

pytestmark = [pytest.mark.integration, NEEDS_BROWSER]
BATTERY = "tr[data-drone='1/1'] td[data-heading='Battery']"
MARKER = "[data-marker='1/1']"
LATE_MS = 60_000


async def test_what_comes_late_is_as_old_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """An update that waited for a minute in a tunnel that stalls, after others that did not."""
    station = FakeStation()
    async with shown(station) as browser:
        await asyncio.to_thread(browser.until_text, BATTERY, "90 %")
        assert not await asyncio.to_thread(browser.value, f'document.querySelector("{MARKER}.stale")')
        now_ms = live.now_ms
        monkeypatch.setattr(live, "now_ms", lambda: now_ms() - LATE_MS)
        station.the_fog.drone(1).set(Battery(80))
        await station.heard.put(StateUpdate(1, 1, Battery(80), 1, 100))
        await asyncio.to_thread(browser.until_text, BATTERY, "80 %")
        age = await asyncio.to_thread(browser.text, f"{BATTERY} small")
        assert 60 <= float(age) < 75
        await asyncio.to_thread(browser.until_text, "#connection", "What is shown is old")
        for stale in (f"{BATTERY} span.stale", f"{MARKER}.stale"):
            assert await asyncio.to_thread(browser.value, f'document.querySelector("{stale}") !== null'), stale


async def test_a_program_that_hangs_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its connection is not closed, and what has no age, as *Reachable*, would look as if it were of now."""
    async with shown(FakeStation()) as browser:
        await asyncio.to_thread(browser.until_text, "#connection", "connected to")
        monkeypatch.setattr(live.Viewer, "take", lambda _: {})
        await asyncio.to_thread(browser.until_text, "#connection", "does not answer")
        await asyncio.to_thread(browser.until_text, "#notice", "does not answer")
        monkeypatch.undo()
        await asyncio.to_thread(browser.until_text, "#connection", "connected to")
        assert await asyncio.to_thread(browser.text, "#notice") == ""


async def test_the_clock_of_another_machine_may_have_stood_still(monkeypatch: pytest.MonkeyPatch) -> None:
    """As that of a station on a machine that was suspended, behind a tunnel: its updates do not look late for good."""
    station = FakeStation()
    async with shown(station) as browser:
        await asyncio.to_thread(browser.until_text, "#connection", "connected to")
        now_ms = live.now_ms
        monkeypatch.setattr(live, "now_ms", lambda: now_ms() - LATE_MS)
        await asyncio.to_thread(browser.until_text, "#connection", "What is shown is old")
        await asyncio.to_thread(browser.until_text, "#connection", "connected to", 40.0)
        assert await asyncio.to_thread(browser.value, f'document.querySelector("{BATTERY} span.stale") === null')
        await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] input")
        await asyncio.to_thread(browser.click, "#send-arm")
        await eventually(lambda: station.sent, "the command")


async def test_a_position_that_is_too_old_looks_it_on_the_map_too() -> None:
    """A drone that is reachable, and knows its place no longer."""
    station = FakeStation()
    drone = station.the_fog.drone(1)
    drone.set(Location(47.0, 8.0, 498.0, 10.0), age_ms=STALE_MS - 2000)
    async with shown(station) as browser:
        await asyncio.to_thread(
            browser.until, f'document.querySelector("{MARKER}.stale") !== null', "it looks old", 20.0
        )
        assert await asyncio.to_thread(browser.value, "document.querySelectorAll('.drones .stale').length") == 1


async def test_a_key_that_is_held_sends_one_command() -> None:
    station = FakeStation()
    async with shown(station) as browser:
        await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] input")
        await asyncio.to_thread(browser.value, "document.querySelector('#send-arm').focus()")
        await asyncio.to_thread(browser.hold, "Enter", 10)
        await eventually(lambda: station.sent, "the command")
        await asyncio.to_thread(browser.press, "h")
        await eventually(lambda: station.sent[-1][1].command.name == "hold", "the next one")
        assert [sent.command.name for _, sent in station.sent] == ["arm", "hold"]


async def test_a_key_that_is_held_on_the_map_clicks_once() -> None:
    async with shown(FakeStation()) as browser:
        await asyncio.to_thread(browser.click, "#draft-draw")
        await asyncio.to_thread(browser.value, "document.querySelector('#map').focus()")
        await asyncio.to_thread(browser.hold, "Enter", 10)
        assert await asyncio.to_thread(browser.value, "document.querySelectorAll('#draft-rows tr').length") == 1


@pytest.mark.parametrize("another", ["fog", "station", "fleet", "broker"])
async def test_a_program_that_comes_back_as_another_one_begins_anew(another: str) -> None:
    """A page that was left open: its drones, and which of them are selected, are not those of now."""
    first, second, port = FakeStation(), FakeStation(), free_port()
    if another == "fog":
        second.the_fog.number = 2
    elif another == "station":
        second.name = "another"
    elif another == "broker":
        second.broker = "127.0.0.1:1890"  # as of the demo
    else:
        second.prefix = "acme/eu/"
    with LivePage() as browser:
        async with served(first, port) as url:
            await asyncio.to_thread(browser.open, url)
            await asyncio.to_thread(browser.click, "tr[data-drone='1/1'] input")
            await asyncio.to_thread(browser.until_text, "#who", "Drone 1")
            await asyncio.to_thread(browser.value, "window.isOfBefore = true")
        await asyncio.to_thread(browser.until_text, "#connection", "does not answer")
        async with served(second, port):
            await asyncio.to_thread(
                browser.until, "window.isOfBefore === undefined && document.readyState === 'complete'", "it is loaded"
            )
            await asyncio.to_thread(browser.until_text, "#who", "Nobody: select a drone")
            rows = "document.querySelectorAll('#fleet-rows tr').length"
            await asyncio.to_thread(browser.until, f"{rows} === 2", "the drones of now alone")
