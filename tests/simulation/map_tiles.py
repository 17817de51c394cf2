"""Map tiles of one colour: as pictures and as shapes, and PMTiles files of them."""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from pathlib import Path

from pmtiles.tile import Compression, TileType, zxy_to_tileid
from pmtiles.writer import write

HIGHEST_ZOOM = 18
SIZE = 256


def png(colour: tuple[int, int, int]) -> bytes:
    """A picture of one colour."""
    rows = (b"\0" + bytes(colour) * SIZE) * SIZE
    header = struct.pack("!IIBBBBB", SIZE, SIZE, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack("!I", len(body)) + kind + body + struct.pack("!I", zlib.crc32(kind + body)) for kind, body in parts
    )


def _field(number: int, body: bytes) -> bytes:
    return bytes([number << 3 | 2, len(body)]) + body


def shapes(layer: str) -> bytes:
    """A vector tile with one area, in a layer, that covers everything."""
    move, lines, close = 1 << 3 | 1, 3 << 3 | 2, 1 << 3 | 7
    far, back = (b"\x80\x40", b"\xff\x3f")  # 4096 and -4096, as zigzag varints
    ring = bytes([move, 0, 0, lines]) + far + b"\0" + b"\0" + far + back + b"\0" + bytes([close])
    area = b"\x18\x03" + _field(4, ring)
    return _field(3, b"\x78\x02" + _field(1, layer.encode()) + _field(2, area) + b"\x28\x80\x20")


def named(layer: str, name: str, kind: str) -> bytes:
    """A vector tile with one point, which has a name and a kind, a quarter from the left and the top."""
    point = bytes([1 << 3 | 1]) + b"\x80\x10\x80\x10"  # 1024, twice
    feature = _field(2, bytes([0, 0, 1, 1])) + b"\x18\x01" + _field(4, point)
    keys = _field(3, b"name") + _field(3, b"kind")
    values = _field(4, _field(1, name.encode())) + _field(4, _field(1, kind.encode()))
    return _field(3, b"\x78\x02" + _field(1, layer.encode()) + _field(2, feature) + keys + values + b"\x28\x80\x20")


def pmtiles(path: Path, tile: bytes, kind: TileType, latitude_deg: float, longitude_deg: float) -> Path:
    """Write a file that has one tile at every place around a position, at every zoom."""
    wanted = set()
    for zoom in range(HIGHEST_ZOOM + 1):
        count = 2**zoom
        column = int((longitude_deg + 180) / 360 * count)
        row = int((1 - math.asinh(math.tan(math.radians(latitude_deg))) / math.pi) / 2 * count)
        wanted |= {
            zxy_to_tileid(zoom, x, y)
            for x in range(max(0, column - 4), min(count, column + 5))
            for y in range(max(0, row - 4), min(count, row + 5))
        }
    packing = Compression.GZIP if kind is TileType.MVT else Compression.NONE
    with write(path) as writer:
        for number in sorted(wanted):
            writer.write_tile(number, gzip.compress(tile) if packing is Compression.GZIP else tile)
        writer.finalize({"tile_type": kind, "tile_compression": packing}, {"attribution": "<b>A & B</b>"})
    return path
