"""Places with names on the live page, in a real Chromium: found by name, chosen on the map, by mouse and keyboard."""

from __future__ import annotations

import asyncio

import pytest

from mqttxt import Goto
from mqttxt.page.places import Place
from tests.rigs.live_page import NEEDS_BROWSER, LivePage
from tests.rigs.made_up_page import shown
from tests.rigs.processes import eventually
from tests.simulation.page_fleet import FakeStation

pytestmark = [pytest.mark.integration, NEEDS_BROWSER]
PHONE, DESK = 400, 1600
CHURCH = Place("Église <b>St. Martin</b>", 47.0009, 8.0011)
WIDE = Place("A name that is as long as the names of many places", 47.0003, 7.9995)
PLACES = (
    CHURCH,
    Place("Mill", 46.9996, 8.0008),
    Place("Mill pond", 46.9994, 7.9999),
    Place("Far town", 47.5, 8.5),
    WIDE,
)
FILLED = "['latitude_deg', 'longitude_deg', 'altitude_m'].map(name => document.getElementById(`goto-${name}`).value)"
AT_CHURCH = ["47.0009000", "8.0011000"]
NOTHING = ["", "", ""]


async def find(browser: LivePage, text: str) -> None:
    await asyncio.to_thread(browser.tab_to, "#place-name")
    await asyncio.to_thread(browser.value, "document.activeElement.select()")
    await asyncio.to_thread(browser.press_all, text)


@pytest.mark.parametrize("width", [PHONE, DESK])
async def test_drone_2_flies_to_the_church_by_mouse(width: int) -> None:
    station = FakeStation()
    async with shown(station, width=width, places=PLACES) as browser:
        await asyncio.to_thread(browser.click, "tr[data-drone='1/2'] th")
        await asyncio.to_thread(browser.click, "#place-list li:first-child button")
        assert await asyncio.to_thread(browser.value, FILLED) == [*AT_CHURCH, "10"]
        await asyncio.to_thread(browser.until_text, "#goto-distance", f"{CHURCH.name}, 77 m from drone 2")
        assert station.sent == [], "to choose a place sends nothing"
        await asyncio.to_thread(browser.click, "#send-goto")
        await eventually(lambda: station.sent, "it is sent")
        ((drone, sent),) = station.sent
        assert (drone, sent.command) == (2, Goto(CHURCH.latitude_deg, CHURCH.longitude_deg, 10))
        await asyncio.to_thread(browser.until_text, "#newest", f"altitude 10 m ({CHURCH.name}) to drone 2: sent")


async def test_drone_2_flies_to_the_church_by_keyboard_alone() -> None:
    station = FakeStation()
    async with shown(station, places=PLACES) as browser:
        await asyncio.to_thread(browser.watch_inputs)
        await asyncio.to_thread(browser.tab_to, "tr[data-drone='1/2'] input")
        await asyncio.to_thread(browser.press, " ")
        await find(browser, "eglise")
        await asyncio.to_thread(browser.press, "Enter")
        await asyncio.to_thread(browser.press, "Enter")
        assert await asyncio.to_thread(browser.value, FILLED) == [*AT_CHURCH, "10"]
        await asyncio.to_thread(browser.until_text, "#place-found", f"{CHURCH.name} is filled in below.")
        assert station.sent == [], "Enter in the field of names sends nothing, however often"
        await asyncio.to_thread(browser.tab_to, "#send-goto")
        await asyncio.to_thread(browser.press, "Enter")
        await eventually(lambda: station.sent, "it is sent")
        assert station.sent[0][0] == 2
        assert (await asyncio.to_thread(browser.inputs))[0] == 0, "no button of the mouse was pressed"


async def test_a_place_is_chosen_on_the_map_by_its_sign_or_its_name_and_gets_its_height_with_the_drone() -> None:
    async with shown(FakeStation(), places=PLACES) as browser:
        await asyncio.to_thread(browser.until, "document.querySelectorAll('.places path').length === 4", "those near")
        for selector in (".places path", ".places text"):
            await asyncio.to_thread(browser.click, "#place-list li:nth-child(2) button")
            await asyncio.to_thread(browser.click, selector)
            assert await asyncio.to_thread(browser.value, FILLED) == [*AT_CHURCH, ""]
        assert await asyncio.to_thread(browser.text, "[aria-pressed=true]") == CHURCH.name
        await asyncio.to_thread(browser.type, "#takeoff-altitude_m", "12.5")
        await asyncio.to_thread(browser.click, "tr[data-drone='1/2'] th")
        assert await asyncio.to_thread(browser.value, FILLED) == [*AT_CHURCH, "12.5"]
        await asyncio.to_thread(browser.type, "#goto-latitude_deg", "47.1")
        assert await asyncio.to_thread(browser.text, "[aria-pressed=true]") == "", "it is another place now"
        assert await asyncio.to_thread(browser.text, "#place-found") == ""


@pytest.mark.parametrize("width", [PHONE, DESK])
async def test_the_map_says_what_go_to_has_leads_there_and_nothing_moves(width: int) -> None:
    async with shown(FakeStation(), width=width, places=PLACES) as browser:
        await asyncio.to_thread(browser.until, "document.querySelectorAll('.places path').length === 4", "those near")
        tops = "['#map-box', '#map-scale', '#send-goto', '#send-pause'].map(s => document.querySelector(s))"
        tops += ".map(e => Math.round(e.getBoundingClientRect().top + scrollY))"
        before = await asyncio.to_thread(browser.value, tops)
        assert not await asyncio.to_thread(browser.value, "document.querySelector('#map-goto').checkVisibility()")
        await asyncio.to_thread(browser.click, "tr[data-drone='1/2'] th")
        await asyncio.to_thread(browser.click, ".places text")
        says = f"Go to has {CHURCH.name}, 77 m from drone 2."
        assert await asyncio.to_thread(browser.text, "#map-chosen") == says
        assert (await asyncio.to_thread(browser.value, tops))[:2] == before[:2]
        assert (await asyncio.to_thread(browser.value, tops))[3] == before[3] or width == PHONE
        await asyncio.to_thread(browser.click, "#map-goto a")
        box = "document.querySelector('#send-goto').getBoundingClientRect()"
        await asyncio.to_thread(browser.until, f"{box}.top >= 0 && {box}.bottom <= innerHeight", "Go to is in sight")
        await asyncio.to_thread(browser.click, "#map", 0.5, 0.98)
        await asyncio.to_thread(browser.until_text, "#map-chosen", "Go to has the place, ")


@pytest.mark.parametrize(
    ("typed", "says"), [("m", "4 places: choose one."), ("zoo", "No place has this in its name."), ("mill", "Mill is")]
)
async def test_a_name_that_is_not_one_place_fills_in_nothing(typed: str, says: str) -> None:
    async with shown(FakeStation(), places=PLACES) as browser:
        await find(browser, typed)
        await asyncio.to_thread(browser.press, "Enter")
        await asyncio.to_thread(browser.until_text, "#place-found", says)
        filled = await asyncio.to_thread(browser.value, FILLED)
        assert (filled == NOTHING) is (not says.startswith("Mill"))


async def test_a_place_that_is_far_is_shown_when_it_is_chosen() -> None:
    async with shown(FakeStation(), places=PLACES) as browser:
        await find(browser, "far")
        await asyncio.to_thread(browser.press, "Enter")
        await asyncio.to_thread(browser.until_text, "#map-scale", " km")
        names = "[...document.querySelectorAll('.places text')].map(e => e.textContent)"
        await asyncio.to_thread(browser.until, f"{names}.includes('Far town')", "it is on the map")
        assert await asyncio.to_thread(browser.value, f"{names}.length") == 2, "of those that are close together one"


async def test_of_many_places_those_are_listed_that_have_the_name() -> None:
    many = tuple(Place(f"Point {number}", 47 + number / 10_000, 8) for number in range(1000))
    async with shown(FakeStation(), places=many) as browser:
        assert await asyncio.to_thread(browser.value, "document.querySelectorAll('#place-list li').length") == 8
        await asyncio.to_thread(browser.until_text, "#place-more", "and 992 more: type a part of the name")
        await find(browser, "point 77")
        await asyncio.to_thread(browser.until_text, "#place-more", "and 3 more")
        await asyncio.to_thread(browser.press, "Enter")
        await asyncio.to_thread(browser.until_text, "#place-found", "Point 77 is filled in")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [PHONE, DESK])
async def test_the_list_fits_and_keeps_nobody_out(width: int, dark: bool) -> None:
    async with shown(FakeStation(), width=width, places=PLACES) as browser:
        await asyncio.to_thread(browser.resize, width, dark)
        await asyncio.to_thread(browser.click, "#place-list li:first-child button")
        assert await asyncio.to_thread(browser.value, "document.documentElement.scrollWidth") == width
        assert await asyncio.to_thread(browser.wider) == []
        cut = """(map => [...document.querySelectorAll('.places text')].map(e => [e, e.getBoundingClientRect()])
          .filter(([, at]) => at.left < map.left || at.right > map.right).map(([e]) => e.textContent))
          (document.getElementById('map').getBoundingClientRect())"""
        assert await asyncio.to_thread(browser.value, cut) == [], "no name is cut"
        assert await asyncio.to_thread(browser.violations) == []
        assert browser.said == []


async def test_without_places_there_is_no_list() -> None:
    async with shown(FakeStation()) as browser:
        await asyncio.to_thread(browser.until, "document.getElementById('send-goto') !== null", "the commands")
        assert not await asyncio.to_thread(browser.value, "document.getElementById('places').checkVisibility()")
        assert not await asyncio.to_thread(browser.value, "document.getElementById('map-places').checkVisibility()")
