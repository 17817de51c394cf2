"""The page's web server: its files, the socket for updates and requests, and the check of who is let in."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import errno
import hashlib
import logging
from collections.abc import Awaitable, Callable
from importlib.resources import files
from typing import Any

from aiohttp import WSMsgType, web

from ..core.address import host_port
from ..errors import ConfigurationError
from .live import Live, Viewer
from .tiles import HIGHEST_ZOOM, TileError, Tiles

logger = logging.getLogger("mqttxt.page")

HTTP_PORT = 80
"""The port that browsers leave out of addresses."""
MOST_REQUEST_BYTES = 2**21
"""Room for the largest plan that a drone accepts, as QGroundControl writes it."""
HEARTBEAT_S = 20.0
SHUTDOWN_S = 1.0
TICK_S = 0.1
"""How often a browser is sent the changes."""
_START = "start.js"
_MODULES = (
    "main",
    "dom",
    "fleet",
    "map",
    "marks",
    "places",
    "commands",
    "log",
    "plans",
    "draft",
    "rankings",
    "sensors",
    "links",
)
_OF_TILES = ("tiles", "shapes", "pbf", "vector-tile", "point-geometry")
_FILES = {
    "page.html": "text/html",
    "page.css": "text/css",
    "page.svg": "image/svg+xml",
    "licences.txt": "text/plain",
    **{f"{name}.js": "text/javascript" for name in (*_MODULES, *_OF_TILES)},
}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self' '{start}'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""The browser connects to this server alone, and runs no script but its files and `start`."""
_OWN_SITES = ("none", "same-origin")
"""What browsers name in `Sec-Fetch-Site` when the user or the page itself asks."""
_KEEP = {"Cache-Control": "private, max-age=3600"}

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Server:
    """Serves one page to any number of browsers on this machine.

    Parameters:
        live: the content, which also takes the requests.
        host: a loopback address or `localhost`.
        port: the port on which to listen.
        tiles: the map's tiles; None: it only has a grid.
    """

    def __init__(self, live: Live, host: str, port: int, tiles: Tiles | None = None) -> None:
        self._live = live
        self._tiles = tiles
        self._host = host
        self._port = port
        self._hosts = [host_port(name, port).removesuffix(f":{HTTP_PORT}") for name in (host, "localhost", "127.0.0.1")]
        self.url = f"http://{self._hosts[0]}/"
        self._sockets: set[web.WebSocketResponse] = set()
        assets = files(__package__) / "assets"
        self._files = {name: (assets / name).read_bytes() for name in _FILES}
        start = (assets / _START).read_bytes()
        self._files["page.html"] = self._files["page.html"].replace(b"<script>", b"<script>" + start)
        hashed = f"sha256-{base64.b64encode(hashlib.sha256(start).digest()).decode()}"
        self._headers = {name: value.format(start=hashed) for name, value in _HEADERS.items()}
        app = web.Application(middlewares=[self._guard])
        app.router.add_get("/", self._page)
        app.router.add_get("/live", self._socket)
        app.router.add_get("/log.jsonl", self._log)
        app.router.add_get(r"/tiles/{zoom:\d{1,2}}/{x:\d{1,8}}/{y:\d{1,8}}", self._tile)
        app.router.add_get("/{name}", self._file)
        app.on_response_prepare.append(self._add_headers)
        app.on_shutdown.append(self._close_sockets)
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=SHUTDOWN_S)

    async def start(self) -> None:
        """Start to listen; raises ConfigurationError if that fails."""
        await self._runner.setup()
        try:
            await web.TCPSite(self._runner, self._host, self._port).start()
        except OSError as error:
            where = f"--listen {host_port(self._host, self._port)}"
            is_taken = error.errno == errno.EADDRINUSE
            why = "another program uses the port; expected a free one" if is_taken else error.strerror or error
            raise ConfigurationError(f"{where}: cannot listen: {why}") from error

    async def stop(self) -> None:
        """Close every browser's connection, and stop; raises nothing."""
        await self._runner.cleanup()

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse requests under another host name, which DNS rebinding may have made to lead here.

        Also refuse those of another website, except for the page itself: it reads no answer, but exports of the log
        without end would delay this page's commands. The socket looks at the Origin, which more browsers send.
        """
        if request.host not in self._hosts:
            raise web.HTTPForbidden(text=f"expected the address {self.url}\n")
        if request.path not in ("/", "/live") and request.headers.get("Sec-Fetch-Site", "none") not in _OWN_SITES:
            raise web.HTTPForbidden(text=f"expected a request of the page {self.url}\n")
        return await handler(request)

    async def _page(self, _request: web.Request) -> web.Response:
        return self._answer("page.html")

    async def _file(self, request: web.Request) -> web.Response:
        name = request.match_info["name"]
        if name not in self._files:
            raise web.HTTPNotFound(text="there is no such file\n")
        return self._answer(name)

    def _answer(self, name: str) -> web.Response:
        return web.Response(body=self._files[name], content_type=_FILES[name], charset="utf-8")

    async def _tile(self, request: web.Request) -> web.Response:
        """A tile of the map: this program fetches it, so that the browser connects to no other server."""
        zoom, x, y = (int(request.match_info[name]) for name in ("zoom", "x", "y"))
        if self._tiles is None or zoom > HIGHEST_ZOOM or max(x, y) >= 2**zoom:
            raise web.HTTPNotFound(text="there is no such tile\n")
        try:
            found = await self._tiles.tile(zoom, x, y)
        except TileError as error:
            logger.warning("%s", error)
            raise web.HTTPBadGateway(text=f"{error}\n") from error
        if not found:
            return web.Response(status=204)
        return web.Response(body=found, content_type="application/octet-stream", headers=_KEEP)

    async def _log(self, request: web.Request) -> web.Response:
        """All entries of the log, or those that contain `search`; with `all` every event."""
        lines = self._live.log.lines(request.query.get("search", ""), "all" in request.query)
        text = await asyncio.to_thread("".join, lines)  # thousands of lines, while events go on
        response = web.Response(text=text, content_type="application/jsonl", charset="utf-8")
        response.headers["Content-Disposition"] = 'attachment; filename="mqttxt-log.jsonl"'
        return response

    async def _socket(self, request: web.Request) -> web.WebSocketResponse:
        """The page's socket. A script of another site has another Origin, and is refused."""
        if request.headers.get("Origin") != f"http://{request.host}":
            raise web.HTTPForbidden(text=f"expected the Origin of {self.url}\n")
        socket = web.WebSocketResponse(max_msg_size=MOST_REQUEST_BYTES, heartbeat=HEARTBEAT_S)
        await socket.prepare(request)
        self._sockets.add(socket)
        viewer = self._live.enter()
        sending = asyncio.create_task(_send(socket, viewer))
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    viewer.answers.append(self._live.on_request(message.data))
        finally:
            sending.cancel()
            self._live.leave(viewer)
            self._sockets.discard(socket)
            with contextlib.suppress(asyncio.CancelledError, ConnectionError):
                await sending
        return socket

    async def _add_headers(self, _request: web.Request, response: web.StreamResponse) -> None:
        for name, value in self._headers.items():
            response.headers.setdefault(name, value)

    async def _close_sockets(self, _app: web.Application) -> None:
        for socket in list(self._sockets):
            await socket.close(message=b"the page's program has ended")


async def _send(socket: web.WebSocketResponse, viewer: Viewer) -> None:
    """Send the changes, one message per tick; a slow browser gets the newest, and delays no other."""
    while True:
        update: dict[str, Any] = viewer.take()
        if update:
            await socket.send_json(update)
        await asyncio.sleep(TICK_S)
