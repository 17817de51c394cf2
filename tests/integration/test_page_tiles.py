"""Tiles below the live page's map in a real Chromium, of a file and of a server; the browser asks the page alone."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from aiohttp import web
from pmtiles.tile import TileType

from mqttxt.page.tiles import opened
from tests.rigs.live_page import NEEDS_BROWSER, LivePage
from tests.rigs.made_up_page import shown
from tests.rigs.processes import free_port
from tests.simulation.map_tiles import named, pmtiles, png, shapes
from tests.simulation.page_fleet import FakeStation

pytestmark = [pytest.mark.integration, NEEDS_BROWSER]
COLOUR = (12, 200, 90)
PLACE = (47.0003, 8.0003)
"""Between the drones of `FakeStation`."""
MIDDLE = """(() => { const canvas = document.getElementById('tiles');
  const probe = new OffscreenCanvas(1, 1).getContext('2d', {willReadFrequently: true});
  probe.drawImage(canvas, -canvas.width / 2 - 5, -canvas.height / 2 - 5);
  return [...probe.getImageData(0, 0, 1, 1).data].slice(0, 3); })()"""


@contextlib.asynccontextmanager
async def shown_on(source: str | None) -> AsyncIterator[LivePage]:
    """The page with these tiles, open in a browser."""
    async with opened(source) as tiles, shown(FakeStation(), tiles=tiles) as browser:
        yield browser


async def middle_is(browser: LivePage, colour: tuple[int, ...]) -> None:
    await asyncio.to_thread(
        browser.until, f"JSON.stringify({MIDDLE}) === '[{','.join(map(str, colour))}]'", "its colour"
    )


async def test_a_file_of_pictures_is_below_the_map(tmp_path: Path) -> None:
    async with shown_on(str(pmtiles(tmp_path / "map.pmtiles", png(COLOUR), TileType.PNG, *PLACE))) as browser:
        await middle_is(browser, COLOUR)
        assert await asyncio.to_thread(browser.text, "#map-credit") == "Map: A & B."
        await asyncio.to_thread(browser.click, "#map-in")
        await middle_is(browser, COLOUR)
        await asyncio.to_thread(browser.click, "[data-marker='1/1'] path")
        await asyncio.to_thread(browser.until_text, "#who", "Drone 1")
        assert await asyncio.to_thread(browser.violations) == []
        assert browser.said == [], "no other host was asked, and nothing was refused"


async def test_a_file_of_shapes_is_painted_in_the_pages_colours_light_and_dark(tmp_path: Path) -> None:
    async with shown_on(str(pmtiles(tmp_path / "map.pmtiles", shapes("water"), TileType.MVT, *PLACE))) as browser:
        await middle_is(browser, (0xBC, 0xD9, 0xEE))
        await asyncio.to_thread(browser.resize, 1600, True)
        await middle_is(browser, (0x14, 0x28, 0x3A))
        assert browser.said == []


async def test_names_of_places_and_what_points_of_interest_are_stand_on_the_map(tmp_path: Path) -> None:
    church = named("pois", "St. Martin", "place_of_worship")
    hill = named("places", "Oak <b>Hill</b>", "village")
    found = "[...new Set([...document.querySelectorAll('#map .names text')].map(e => e.textContent))].join()"
    for tile, name in ((church, "St. Martin, place of worship"), (church + hill, "Oak <b>Hill</b>")):
        async with shown_on(str(pmtiles(tmp_path / "map.pmtiles", tile, TileType.MVT, *PLACE))) as browser:
            for _ in range(4):
                await asyncio.to_thread(browser.click, "#map-out")
            await asyncio.to_thread(browser.until, f"{found} !== ''", "names")
            assert await asyncio.to_thread(browser.value, found) == name, "alone, where two are at one place"
            assert await asyncio.to_thread(browser.violations) == []
            assert browser.said == []


async def test_a_tile_server_is_asked_by_the_page_alone() -> None:
    asked: list[web.Request] = []

    async def tile(request: web.Request) -> web.Response:
        asked.append(request)
        return web.Response(body=png(COLOUR), content_type="image/png")

    app = web.Application()
    app.router.add_get("/{z}/{x}/{y}.png", tile)
    runner, port = web.AppRunner(app), free_port()
    await runner.setup()
    try:
        await web.TCPSite(runner, "127.0.0.1", port).start()
        async with shown_on(f"http://127.0.0.1:{port}/{{z}}/{{x}}/{{y}}.png") as browser:
            await middle_is(browser, COLOUR)
            assert asked
            assert {request.headers["User-Agent"] for request in asked} == {"mqttxt"}, "no browser asked"
            assert browser.said == []
    finally:
        await runner.cleanup()


async def test_without_tiles_there_is_the_grid() -> None:
    async with shown_on(None) as browser:
        await asyncio.to_thread(browser.until, "document.querySelectorAll('#map .grid line').length > 0", "the grid")
        assert await asyncio.to_thread(browser.value, "document.getElementById('tiles').hidden")
        assert await asyncio.to_thread(browser.text, "#map-credit") == ""
