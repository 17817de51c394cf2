"""The live page of a made-up fleet, in the test's own process, and a browser that shows it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import cast

from mqttxt import Fog, GroundStation
from mqttxt.page.places import Place
from mqttxt.page.process import serve
from mqttxt.page.tiles import Tiles
from tests.rigs.live_page import LivePage
from tests.rigs.processes import eventually, free_port
from tests.simulation.page_fleet import FakeLinks, FakeStation


@contextlib.asynccontextmanager
async def served(
    station: FakeStation,
    port: int,
    links: FakeLinks | None = None,
    places: tuple[Place, ...] = (),
    tiles: Tiles | None = None,
) -> AsyncIterator[str]:
    """Serve the page at a port, and yield its address."""
    fogs = cast("list[Fog]", [station.the_fog])
    serving = asyncio.create_task(
        serve(cast("GroundStation", station), fogs, "127.0.0.1", port, False, links, tiles, places)
    )
    try:
        yield f"http://127.0.0.1:{port}/"
    finally:
        serving.cancel()
        await eventually(serving.done, "the page has ended")
        if not serving.cancelled():
            serving.result()


@contextlib.asynccontextmanager
async def shown(
    station: FakeStation,
    links: FakeLinks | None = None,
    width: int = 1600,
    places: tuple[Place, ...] = (),
    tiles: Tiles | None = None,
) -> AsyncIterator[LivePage]:
    """The page in a browser; run the browser's calls in a thread, beside the page's loop."""
    async with served(station, free_port(), links, places, tiles) as url:
        with LivePage() as browser:
            await asyncio.to_thread(browser.open, url, width)
            yield browser
