"""Where the live page's tiles come from, and what is wrong with what was given (docs/page.md)."""

from __future__ import annotations

import gzip
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from aiohttp import web
from pmtiles.tile import TileType

from mqttxt import ConfigurationError
from mqttxt.page import tiles
from mqttxt.page.tiles import MOST_TILE_BYTES, Offer, TileError, Tiles, opened
from tests.rigs.loopback import free_port
from tests.simulation.map_tiles import HIGHEST_ZOOM, pmtiles, png, shapes
from tests.unit.mqttxt.test_page_server import served
from tests.unit.mqttxt.typed import refused

PICTURE = png((1, 2, 3))


async def test_a_file_has_its_tiles_and_says_whose_they_are(tmp_path: Path) -> None:
    path = pmtiles(tmp_path / "a.pmtiles", PICTURE, TileType.PNG, 47, 8)
    async with opened(str(path)) as tiles:
        assert tiles is not None
        assert tiles.offer == Offer(0, HIGHEST_ZOOM, shapes=False, credit="A & B")
        assert await tiles.tile(0, 0, 0) == PICTURE
        assert await tiles.tile(10, 0, 0) is None


async def test_shapes_are_unpacked(tmp_path: Path) -> None:
    async with opened(str(pmtiles(tmp_path / "a.pmtiles", shapes("water"), TileType.MVT, 47, 8))) as tiles:
        assert tiles is not None
        assert tiles.offer.shapes
        assert await tiles.tile(0, 0, 0) == shapes("water")


async def test_a_file_that_is_cut_afterwards_is_an_error_of_its_tile(tmp_path: Path) -> None:
    path = pmtiles(tmp_path / "a.pmtiles", shapes("water"), TileType.MVT, 47, 8)
    async with opened(str(path)) as tiles:
        assert tiles is not None
        path.write_bytes(path.read_bytes()[:140])
        with pytest.raises(TileError, match="tile 0/0/0: cannot be read"):
            await tiles.tile(0, 0, 0)


@pytest.mark.parametrize("content", [b"", b"PMTiles", b"no tiles" * 100, b"PMTiles\x02" + bytes(200), b"\xff" * 300])
async def test_another_file_is_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.pmtiles"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=f"--tiles {path}: expected a PMTiles file of version 3$"):
        async with opened(str(path)):
            pass


async def test_kinds_of_tiles_that_no_browser_shows_are_one_line(tmp_path: Path) -> None:
    path = pmtiles(tmp_path / "a.pmtiles", PICTURE, TileType.MLT, 47, 8)
    with pytest.raises(ConfigurationError, match="tiles MLT: expected PNG, JPEG, WEBP, AVIF or MVT"):
        async with opened(str(path)):
            pass


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("missing.pmtiles", "--tiles missing.pmtiles: No such file or directory; expected FILE.pmtiles, or"),
        ("https://tiles.example/{z}/{x}.png", "expected FILE.pmtiles, or a tile server's address, as https://"),
        ("ftp://tiles.example/{z}/{x}/{y}.png", "expected FILE.pmtiles, or a tile server's address"),
        ("https://[tiles/{z}/{x}/{y}.png", "expected FILE.pmtiles, or a tile server's address"),
        ("https://tiles.example:99999/{z}/{x}/{y}.png", "expected FILE.pmtiles, or a tile server's address"),
        ("https:///{z}/{x}/{y}.png", "expected FILE.pmtiles, or a tile server's address"),
        ("http://tiles.example/{z}/{x}/{y}.png", "expected https:// to another machine"),
    ],
)
def test_a_wrong_source_is_one_line(source: str, says: str) -> None:
    assert says in refused("gs", "page", "--fog", 1, "--tiles", source)


async def test_a_servers_offer_follows_from_its_address() -> None:
    async with opened("https://tiles.example/{z}/{x}/{y}.png?key=1") as tiles:
        assert tiles is not None
        assert tiles.offer == Offer(0, 19, shapes=False, credit="tiles.example")
    async with opened("https://tiles.example/{z}/{x}/{y}.mvt") as tiles:
        assert tiles is not None
        assert tiles.offer == Offer(0, 14, shapes=True, credit="tiles.example")


Answering = Callable[[web.Request], Awaitable[web.Response]]


async def answered(answering: Answering) -> bytes | None:
    """What comes of tile 3/4/5 of a server that answers so."""
    server, port = web.Application(), free_port()
    server.router.add_get("/3/4/5.png", answering)
    runner = web.AppRunner(server)
    await runner.setup()
    try:
        await web.TCPSite(runner, "127.0.0.1", port).start()
        async with opened(f"http://127.0.0.1:{port}/{{z}}/{{x}}/{{y}}.png") as tiles:
            assert tiles is not None
            return await tiles.tile(3, 4, 5)
    finally:
        await runner.cleanup()


async def test_a_servers_tiles_and_its_gaps() -> None:
    async def picture(_request: web.Request) -> web.Response:
        return web.Response(body=PICTURE)

    async def nothing(_request: web.Request) -> web.Response:
        raise web.HTTPNotFound

    assert await answered(picture) == PICTURE
    assert await answered(nothing) is None


async def test_what_a_server_does_wrong_is_an_error_of_its_tile() -> None:
    async def elsewhere(_request: web.Request) -> web.Response:
        raise web.HTTPFound("http://127.0.0.1:1/")

    async def endless(_request: web.Request) -> web.Response:
        return web.Response(body=bytes(MOST_TILE_BYTES + 1))

    with pytest.raises(TileError, match="tile 3/4/5: the tile server answers 302"):
        await answered(elsewhere)
    with pytest.raises(TileError, match=f"larger than {MOST_TILE_BYTES} bytes"):
        await answered(endless)
    async with opened(f"http://127.0.0.1:{free_port()}/{{z}}/{{x}}/{{y}}.png") as tiles:
        assert tiles is not None
        with pytest.raises(TileError, match="the tile server does not answer"):
            await tiles.tile(3, 4, 5)


class _Broken:
    offer = Offer(0, 5, shapes=False, credit="nobody")

    async def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        if x == 1:
            raise TileError("tile 1/1/0: broken")
        return None if y else PICTURE


@pytest.mark.parametrize(
    ("tiles", "path", "status"),
    [
        (_Broken(), "1/0/0", 200),
        (_Broken(), "1/0/1", 204),
        (_Broken(), "1/1/0", 502),
        (_Broken(), "1/2/0", 404),
        (_Broken(), "23/0/0", 404),
        (_Broken(), "-1/0/0", 404),
        (_Broken(), "1/0/0.png", 404),
        (None, "1/0/0", 404),
    ],
)
async def test_the_page_serves_them(tiles: Tiles | None, path: str, status: int) -> None:
    async with served(tiles) as (server, session), session.get(f"{server.url}tiles/{path}") as answer:
        assert answer.status == status
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        if status == 200:
            assert await answer.read() == PICTURE
            assert answer.content_type == "application/octet-stream"


def _with_header(path: Path, place: int, value: bytes) -> Path:
    """A good file with other bytes at a place of its header."""
    found = bytearray(pmtiles(path, PICTURE, TileType.PNG, 47, 8).read_bytes())
    found[place : place + len(value)] = value
    path.write_bytes(found)
    return path


@pytest.mark.parametrize(
    ("place", "value"),
    [(100, bytes([200, 250])), (8, b"\xff" * 8), (16, b"\xff" * 7 + b"\x7f"), (24, b"\xff" * 8), (32, b"\xff" * 8)],
    ids=["zoom", "root's place", "root's length", "metadata's place", "metadata's length"],
)
async def test_a_damaged_header_is_one_line(tmp_path: Path, place: int, value: bytes) -> None:
    path = _with_header(tmp_path / "a.pmtiles", place, value)
    with pytest.raises(ConfigurationError, match=f"--tiles {path}: expected a PMTiles file of version 3$"):
        async with opened(str(path)):
            pass


async def test_metadata_nested_too_deep_is_one_line(tmp_path: Path) -> None:
    path = pmtiles(tmp_path / "a.pmtiles", PICTURE, TileType.PNG, 47, 8)
    header, deep = path.read_bytes()[:127], gzip.compress(b"[" * 200_000)
    where = b"".join(number.to_bytes(8, "little") for number in (127, len(deep)))
    path.write_bytes(header[:24] + where + header[40:] + deep)
    with pytest.raises(ConfigurationError, match=f"--tiles {path}: expected a PMTiles file of version 3$"):
        async with opened(str(path)):
            pass


async def test_a_name_that_no_file_has_is_one_line() -> None:
    with pytest.raises(ConfigurationError, match=r"^--tiles a\\x00b: embedded null byte; expected FILE.pmtiles"):
        async with opened("a\0b"):
            pass


@pytest.mark.parametrize("more", [0, 1])
async def test_a_tile_that_unpacks_to_too_much_is_an_error_of_its_tile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: int
) -> None:
    monkeypatch.setattr(tiles, "MOST_TILE_BYTES", 1000)
    path = pmtiles(tmp_path / "a.pmtiles", bytes(1000 + more), TileType.MVT, 47, 8)
    async with opened(str(path)) as found:
        assert found is not None
        if more:
            with pytest.raises(TileError, match="tile 0/0/0: cannot be read: larger than 1000 bytes"):
                await found.tile(0, 0, 0)
        else:
            assert await found.tile(0, 0, 0) == bytes(1000)
