"""`mqttxt demo`: simulated drones on this machine."""

from __future__ import annotations

from typing import Annotated

import typer

from .common import check_system, errors_as_lines, run
from .page import whole_paths


def demo(
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in a browser, too.")] = False,
    tiles: Annotated[
        str | None,
        typer.Option(help="A PMTiles file, or a tile server as https://HOST/{z}/{x}/{y}.png, below the page's map."),
    ] = None,
    places: Annotated[
        str | None, typer.Option(help="A GeoJSON file of points with names for the page, in place of invented ones.")
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show also what each part writes.")] = False,
) -> None:
    """Fly four simulated drones on this machine, on a page in the browser, until Ctrl-C; without Docker."""
    check_system("demo")
    from ..demo.process import Demo

    async def job() -> None:
        of_tiles, of_places = await whole_paths(tiles, places)
        await Demo(typer.echo, verbose, open_page, tiles=of_tiles, places=of_places).run()

    with errors_as_lines():
        run(job())
