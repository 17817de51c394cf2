"""The page's program: its web server and its content, on one event loop."""

from __future__ import annotations

import logging

from ..core.address import BrokerAddress, host_port
from ..errors import ConfigurationError
from ..station.fleets import Fleets
from ..station.ground_station import GroundStation
from ..station.views import Fog
from .links import Links
from .live import Live
from .places import Place
from .server import Server
from .tiles import Tiles

logger = logging.getLogger("mqttxt.page")


def check_listen(host: str, port: int) -> tuple[str, int]:
    """The host and port on which to listen; raises ConfigurationError for anything but this machine."""
    if not BrokerAddress(host, port).is_loopback:
        raise ConfigurationError(
            f"--listen {host_port(host, port)}: expected this machine, as 127.0.0.1:{port}: the page has no login, and "
            "whoever opens it commands the drones"
        )
    return host, port


async def serve(
    station: GroundStation | Fleets,
    fogs: list[Fog],
    host: str,
    port: int,
    watch_only: bool,
    links: Links | None = None,
    tiles: Tiles | None = None,
    places: tuple[Place, ...] = (),
) -> None:
    """Serve the page until cancelled, or until the station has ended.

    Parameters:
        station: an entered station, or several as one; `control=False` if `watch_only`.
        fogs: the fogs that it is connected to.
        host: a loopback address.
        port: the port on which to listen.
        watch_only: no page can command.
        links: links to show and change; None: none.
        tiles: the map's tiles; None: it only has a grid.
        places: places that the map shows and that are found by name.

    Raises:
        ConfigurationError: the server cannot listen there.
        BrokerRefused: the broker has ended the station.
    """
    live = Live(station, fogs, watch_only, links, None if tiles is None else tiles.offer, places)
    server = Server(live, host, port, tiles)
    await server.start()
    logger.info("open %s%s", server.url, " (it only watches)" if watch_only else "")
    try:
        await live.run()
    finally:
        await server.stop()
