"""Tiles for the map, from a PMTiles file or from a tile server, which only this program contacts."""

from __future__ import annotations

import asyncio
import contextlib
import re
import zlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

import aiohttp
from pmtiles.reader import Reader
from pmtiles.tile import Compression, MagicNumberNotFound, SpecVersionUnsupported, TileType

from ..core.address import BrokerAddress
from ..core.printable import printable
from ..errors import ConfigurationError

MOST_TILE_BYTES = 2**23
ANSWER_S = 20.0
"""How long a tile server may take to answer."""
HIGHEST_ZOOM = 22
_ADDRESS = "https://tiles.example/{z}/{x}/{y}.png"
_EXPECTED = f"expected FILE.pmtiles, or a tile server's address, as {_ADDRESS}"
_FIELDS = ("{z}", "{x}", "{y}")
_SHAPES = (".mvt", ".pbf")
"""The endings of vector tiles' addresses."""
_HIGHEST = {True: 14, False: 19}
"""The highest zoom of tile servers: for vector tiles, and for pictures."""
_MARKUP = re.compile(r"<[^>]*>")
_BROKEN = (OSError, EOFError, ValueError, LookupError, OverflowError, MemoryError, RecursionError, zlib.error)
"""The exceptions of reading a file that is invalid or incomplete."""


class TileError(Exception):
    """A tile that is not available now; the text is one line."""


@dataclass(frozen=True)
class Offer:
    """The tiles that a source offers.

    Parameters:
        lowest: the lowest zoom, 0 for the whole world in one tile.
        highest: the highest zoom.
        shapes: True for vector tiles, which the browser paints; False for pictures.
        credit: the attribution, as plain text.
    """

    lowest: int
    highest: int
    shapes: bool
    credit: str


class Tiles(Protocol):
    """A source of tiles."""

    offer: Offer

    async def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        """A tile, or None if there is none; raises TileError."""


@contextlib.asynccontextmanager
async def opened(source: str | None) -> AsyncIterator[Tiles | None]:
    """The tiles that `--tiles` names, None without it; raises ConfigurationError."""
    if source is None:
        yield None
    elif "://" in source:
        offer = _offer_of_server(source)
        timeout = aiohttp.ClientTimeout(total=ANSWER_S)
        async with aiohttp.ClientSession(timeout=timeout, headers={"User-Agent": "mqttxt"}) as session:
            yield TileServer(source, offer, session)
    else:
        yield await asyncio.to_thread(TileFile, source)


class TileFile:
    """A PMTiles file; raises ConfigurationError for any other.

    Parameters:
        source: its path.
    """

    def __init__(self, source: str) -> None:
        path = Path(source)
        try:
            path.open("rb").close()
        except (OSError, ValueError) as error:  # ValueError: a NUL in the name
            why = error.strerror if isinstance(error, OSError) else error
            raise ConfigurationError(f"--tiles {printable(source)}: {why}; {_EXPECTED}") from error
        self._reader = Reader(_bytes_of(path))
        try:
            header, metadata = self._reader.header(), self._reader.metadata()
            self._reader.get(header["min_zoom"], 0, 0)
        except (MagicNumberNotFound, SpecVersionUnsupported, *_BROKEN) as error:
            raise ConfigurationError(f"--tiles {source}: expected a PMTiles file of version 3") from error
        kind, self._packing = header["tile_type"], header["tile_compression"]
        if kind in (TileType.UNKNOWN, TileType.MLT):
            raise ConfigurationError(f"--tiles {source}: tiles {kind.name}: expected PNG, JPEG, WEBP, AVIF or MVT")
        if self._packing not in (Compression.NONE, Compression.GZIP):
            raise ConfigurationError(f"--tiles {source}: compression {self._packing.name}: expected GZIP or NONE")
        credit = _credit(metadata) or path.name
        self.offer = Offer(header["min_zoom"], header["max_zoom"], kind is TileType.MVT, credit)

    async def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        """A tile, or None if there is none; raises TileError."""
        return await asyncio.to_thread(self._read, zoom, x, y)

    def _read(self, zoom: int, x: int, y: int) -> bytes | None:
        try:
            found: bytes | None = self._reader.get(zoom, x, y)
            return _unpacked(found) if found and self._packing is Compression.GZIP else found
        except _BROKEN as error:
            raise TileError(f"tile {zoom}/{x}/{y}: cannot be read: {printable(str(error))}") from error


class TileServer:
    """A tile server; each tile is fetched when a browser requests it.

    Parameters:
        address: its address, with `{z}`, `{x}` and `{y}`.
        offer: the tiles that it is assumed to have.
        session: the HTTP session for its requests.
    """

    def __init__(self, address: str, offer: Offer, session: aiohttp.ClientSession) -> None:
        self._address = address
        self.offer = offer
        self._session = session

    async def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        """A tile, or None if there is none; raises TileError. Redirections are not followed."""
        address = self._address
        for field, value in zip(_FIELDS, (zoom, x, y), strict=True):
            address = address.replace(field, str(value))
        try:
            async with self._session.get(address, allow_redirects=False) as answer:
                if answer.status in (204, 404):
                    return None
                if answer.status != 200:
                    raise TileError(f"tile {zoom}/{x}/{y}: the tile server answers {answer.status}")
                return await _body(answer)
        except (aiohttp.ClientError, TimeoutError) as error:
            raise TileError(f"tile {zoom}/{x}/{y}: the tile server does not answer") from error


async def _body(answer: aiohttp.ClientResponse) -> bytes:
    found = bytearray()
    async for chunk in answer.content.iter_chunked(2**16):
        found += chunk
        if len(found) > MOST_TILE_BYTES:
            raise TileError(f"a tile of the tile server is larger than {MOST_TILE_BYTES} bytes")
    return bytes(found)


def _offer_of_server(source: str) -> Offer:
    try:
        parts, port = urlsplit(source), urlsplit(source).port
    except ValueError:
        raise ConfigurationError(f"--tiles {source}: {_EXPECTED}") from None
    if parts.scheme not in ("http", "https") or not parts.hostname or any(source.count(one) != 1 for one in _FIELDS):
        raise ConfigurationError(f"--tiles {source}: {_EXPECTED}")
    if parts.scheme == "http" and not BrokerAddress(parts.hostname, port or 80).is_loopback:
        raise ConfigurationError(f"--tiles {source}: expected https:// to another machine")
    shapes = parts.path.endswith(_SHAPES)
    return Offer(0, _HIGHEST[shapes], shapes, parts.hostname)


def _bytes_of(path: Path) -> Callable[[int, int], bytes]:
    def read(offset: int, length: int) -> bytes:
        with path.open("rb") as file:
            file.seek(offset)
            return file.read(min(length, path.stat().st_size))  # a damaged file may name any length

    return read


def _unpacked(packed: bytes) -> bytes:
    """A tile without its gzip compression; raises ValueError for one that is too large, EOFError for a part of one."""
    unpacker = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    found = unpacker.decompress(packed, MOST_TILE_BYTES + 1)
    if len(found) > MOST_TILE_BYTES:
        raise ValueError(f"larger than {MOST_TILE_BYTES} bytes")
    if not unpacker.eof:
        raise EOFError("its end is missing")
    return found


def _credit(metadata: object) -> str:
    """The attribution that a file names, without markup."""
    found = metadata.get("attribution") if isinstance(metadata, dict) else None
    return printable(_MARKUP.sub("", found)).strip() if isinstance(found, str) else ""
