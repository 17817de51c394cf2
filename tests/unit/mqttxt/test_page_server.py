"""The page's web server: who is let in, and what the browser may do (docs/page.md)."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, cast

import aiohttp
import pytest

import mqttxt.page
from mqttxt import ConfigurationError, Fog, GroundStation
from mqttxt.page.live import Live
from mqttxt.page.process import check_listen, serve
from mqttxt.page.server import _FILES, _START, MOST_REQUEST_BYTES, Server
from mqttxt.page.tiles import Tiles
from tests.rigs.loopback import eventually, free_port
from tests.simulation.page_fleet import FakeStation
from tests.unit.mqttxt.typed import refused

ASSETS = Path(mqttxt.page.__file__).parent / "assets"


def watching(station: FakeStation) -> Live:
    """A page of a station, which only watches."""
    return Live(cast("GroundStation", station), cast("list[Fog]", [station.the_fog]), watch_only=True)


@contextlib.asynccontextmanager
async def served(tiles: Tiles | None = None) -> AsyncIterator[tuple[Server, aiohttp.ClientSession]]:
    server = Server(watching(FakeStation()), "127.0.0.1", free_port(), tiles)
    await server.start()
    try:
        async with aiohttp.ClientSession() as session:
            yield server, session
    finally:
        await server.stop()


async def test_every_file_is_served_and_allows_the_browser_nothing_else() -> None:
    assert {path.name for path in ASSETS.iterdir()} == {*_FILES, _START}
    async with served() as (server, session):
        for name in ("", "log.jsonl", "no-such-file", "..%2fserver.py", *_FILES):
            async with session.get(server.url + name) as answer:
                assert answer.status == (404 if name in ("no-such-file", "..%2fserver.py") else 200), name
                policy = answer.headers["Content-Security-Policy"]
                assert "default-src 'none'" in policy
                assert "unsafe" not in policy
                assert "*" not in policy
                assert answer.headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1.evil.example:{port}", "evil.example:{port}"])
async def test_another_name_for_this_address_is_refused(host: str) -> None:
    async with served() as (server, session):
        port = server.url.rpartition(":")[2].strip("/")
        async with session.get(server.url, headers={"Host": host.format(port=port)}) as answer:
            assert answer.status == 403
        async with session.get(server.url, headers={"Host": f"localhost:{port}"}) as answer:
            assert answer.status == 200


@pytest.mark.parametrize(
    ("host", "port", "url"),
    [
        *(("127.0.0.1", 8080, "http://127.0.0.1:8080/"), ("127.0.0.1", 80, "http://127.0.0.1/")),
        *(("::1", 8080, "http://[::1]:8080/"), ("::1", 80, "http://[::1]/"), ("localhost", 80, "http://localhost/")),
    ],
)
async def test_its_address_is_as_browsers_write_it(host: str, port: int, url: str) -> None:
    assert Server(watching(FakeStation()), host, port).url == url


async def test_an_address_of_ipv6_is_named_as_it_is_typed() -> None:
    with pytest.raises(ConfigurationError, match=r"^--listen \[::1%nowhere\]:8080: cannot listen: "):
        await Server(watching(FakeStation()), "::1%nowhere", 8080).start()


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
async def test_another_site_makes_the_program_do_nothing(site: str) -> None:
    """It could read no answer, but ask without end for the log, or for tiles."""
    async with served() as (server, session):
        for name in ("log.jsonl?all", "tiles/1/0/0", "main.js"):
            async with session.get(server.url + name, headers={"Sec-Fetch-Site": site}) as answer:
                assert answer.status == 403, name
        async with session.get(server.url, headers={"Sec-Fetch-Site": site}) as answer:
            assert answer.status == 200, "a link to the page"
        for own in ("same-origin", "none"):
            async with session.get(f"{server.url}log.jsonl", headers={"Sec-Fetch-Site": own}) as answer:
                assert answer.status == 200


@pytest.mark.parametrize("origin", [None, "null", "https://evil.example", "http://127.0.0.1", "http://127.0.0.1:1"])
async def test_another_sites_socket_is_refused(origin: str | None) -> None:
    async with served() as (server, session):
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(f"{server.url}live", origin=origin)
        assert refused.value.status == 403


async def test_nothing_but_the_socket_takes_requests() -> None:
    async with served() as (server, session):
        for name in ("", "live", "log.jsonl"):
            async with session.post(server.url + name, data="x") as answer:
                assert answer.status == 405


async def test_a_request_that_is_too_long_ends_its_socket_alone() -> None:
    async with served() as (server, session):
        origin = server.url.rstrip("/")
        async with (
            session.ws_connect(f"{server.url}live", origin=origin) as bad,
            session.ws_connect(f"{server.url}live", origin=origin) as good,
        ):
            assert "hello" in (await bad.receive_json())
            await bad.send_str(" " * (MOST_REQUEST_BYTES + 1))
            while (await bad.receive()).type is not aiohttp.WSMsgType.CLOSE:
                pass
            await good.send_str("{")
            answers: list[Any] = []
            while not answers:
                answers = (await good.receive_json()).get("answers", [])
            assert answers == [{"number": None, "error": "request: expected JSON"}]


async def test_a_page_that_ends_takes_leave_of_its_browsers() -> None:
    station = FakeStation()
    port = free_port()
    fogs = cast("list[Fog]", [station.the_fog])
    serving = asyncio.create_task(serve(cast("GroundStation", station), fogs, "127.0.0.1", port, watch_only=False))
    async with aiohttp.ClientSession() as session:
        url = f"http://127.0.0.1:{port}"

        async def connected() -> aiohttp.ClientWebSocketResponse:
            while True:
                with contextlib.suppress(aiohttp.ClientConnectorError):
                    return await session.ws_connect(f"{url}/live", origin=url)
                await asyncio.sleep(0.02)

        socket = await connected()
        await socket.receive_json()
        serving.cancel()
        await eventually(serving.done, "the page has ended")
        assert (await socket.receive()).type is aiohttp.WSMsgType.CLOSE
        await socket.close()


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.2", "gs.example", "::"])
def test_another_machine_is_not_let_in(host: str) -> None:
    with pytest.raises(ConfigurationError, match=r"expected this machine, as 127\.0\.0\.1:8080: the page has no login"):
        check_listen(host, 8080)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1"])
def test_this_machine_is(host: str) -> None:
    assert check_listen(host, 8080) == (host, 8080)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--listen", "0.0.0.0:8080"], "--listen 0.0.0.0:8080: expected this machine"),
        (["--listen", "8080"], "--listen '8080': expected HOST:PORT"),
        (["--qos", "2"], "--qos 2: expected 0 or 1"),
        (["--cloud", "http://x"], "--cloud 'http://x': expected mqtt://"),
    ],
)
def test_a_wrong_option_is_one_line(arguments: list[str], says: str) -> None:
    assert says in refused("gs", "page", "--fog", 1, *arguments)


def test_without_aiohttp_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("mqttxt.page.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    assert refused("gs", "page", "--fog", 1) == "page: expected aiohttp: pip install 'mqttxt[page]'"


async def test_a_port_that_is_taken_is_one_line() -> None:
    async with served() as (server, _):
        port = int(server.url.rpartition(":")[2].strip("/"))
        station = FakeStation()
        fogs = cast("list[Fog]", [station.the_fog])
        with pytest.raises(
            ConfigurationError,
            match=f"--listen 127.0.0.1:{port}: cannot listen: another program uses the port; expected a free one",
        ):
            await serve(cast("GroundStation", station), fogs, "127.0.0.1", port, watch_only=False)
