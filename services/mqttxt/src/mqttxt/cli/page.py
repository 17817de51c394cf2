"""`mqttxt gs page`: the live page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.address import address_of
from ..errors import ConfigurationError
from .advice import connect
from .common import errors_as_lines, run_coroutine, set_up_logging, settings
from .gs import Json, Qos
from .station import FogNumbers, StationOptions, of_a_station


@of_a_station
def page(
    options: StationOptions,
    fog: FogNumbers,
    listen: Annotated[
        str, typer.Option(help="HOST:PORT where the browser finds the page, on this machine alone.")
    ] = "127.0.0.1:8080",
    watch_only: Annotated[bool, typer.Option("--watch-only", help="Take no control, and command nothing.")] = False,
    tiles: Annotated[
        str | None,
        typer.Option(help="A PMTiles file, or a tile server as https://HOST/{z}/{x}/{y}.png, below the map."),
    ] = None,
    places: Annotated[
        str | None, typer.Option(help="A GeoJSON file of points with names, shown on the map and found by name.")
    ] = None,
    qos: Qos = 1,
    json: Json = False,
) -> None:
    """Serve a page on which the drones are watched and flown, until Ctrl-C."""
    try:
        from ..page.places import load
        from ..page.process import check_listen, serve
        from ..page.tiles import opened
    except ModuleNotFoundError as error:
        with errors_as_lines():
            raise _missing(error) from None
    set_up_logging(verbose=False)

    async def job() -> int:
        host, port = check_listen(*address_of(listen, "--listen"))
        named = load(places)
        fogs_of = options.fogs_of(fog)
        async with (
            opened(tiles) as offered,
            options.joined(fogs_of, settings(qos, json), control=not watch_only) as station,
        ):
            fogs = await connect(station, fogs_of, options.timeout)
            await serve(station, fogs, host, port, watch_only, tiles=offered, places=named)
        return 0

    run_coroutine(job())


async def whole_paths(tiles: str | None, places: str | None) -> tuple[str | None, str | None]:
    """`--tiles` and `--places` as absolute paths, for a page in another folder; raises ConfigurationError."""
    from ..page.places import load

    load(places)
    found = None if places is None else str(Path(places).absolute())
    if tiles is None:
        return None, found
    try:
        from ..page.tiles import opened
    except ModuleNotFoundError as error:
        raise _missing(error) from None
    async with opened(tiles):
        return tiles if "://" in tiles else str(Path(tiles).absolute()), found


def _missing(error: ModuleNotFoundError) -> ConfigurationError:
    return ConfigurationError(f"page: expected {error.name}: pip install 'mqttxt[page]'")
