"""CBOR as payloads are written and read: canonical, of bounded length and depth, without tags."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Any, NoReturn

import cbor2

from ..errors import PayloadError
from .values import Plain

MAX_PAYLOAD = 61_440
"""Bytes; a longer payload is refused unread. The rankings of 250 drones in JSON are shorter."""
_MAX_DEPTH = 8
_MOST_PAIRS = 8
"""Of a map; COSE's header, the only one that there is, has three."""
_QUICK = 2048
"""Bytes of a payload that costs little to read, whatever it is."""
_ARGUMENT_BYTES = {24: 1, 25: 2, 26: 4, 27: 8}
"""By the low five bits of an item's first byte (RFC 8949, section 3)."""
_BYTES, _TEXT, _MAP = 2, 3, 5
_PAIR = b"\x82"
_END = secrets.token_bytes(16)
_END_ITEM = b"\x50" + _END
"""Nobody knows what stands behind a payload: what is read there shows that the payload was one item, and whole.

cbor2 says where an item ended only of a stream, of which it takes twice as long to read.
"""


class _NoTags(dict[int, Callable[..., NoReturn]]):
    """Refuses every tag. No message has one, and what a tag makes of a value can cost anything: 60 kB of a regular
    expression (35) take half a minute to read, some hundred bytes that refer to each other (28, 29) fill a memory.
    """

    def __missing__(self, tag: int) -> Callable[..., NoReturn]:
        return _refuse_tag


def _refuse_tag(*_: Any) -> NoReturn:
    raise ValueError("a tag")


NO_TAGS = _NoTags()


def encode_plain(plain: Plain) -> bytes:
    """CBOR of what is an array of a message already; floats in the shortest form that loses nothing."""
    return cbor2.dumps(plain, canonical=True)


def check_length(payload: bytes) -> None:
    """Raises PayloadError for a payload that is not read, in either form."""
    if not payload:
        raise PayloadError("payload: expected CBOR or JSON, got nothing", "empty")
    if len(payload) > MAX_PAYLOAD:
        raise PayloadError(f"payload: expected at most {MAX_PAYLOAD} bytes, got {len(payload)}", "too_long")


def parse_cbor(data: bytes) -> Plain:
    """What one item of CBOR says; raises PayloadError for anything else."""
    if not 0 < len(data) <= MAX_PAYLOAD:
        raise PayloadError(f"payload: expected 1 to {MAX_PAYLOAD} bytes, got {len(data)}", "too_long")
    return read_cbor(data)


def check_maps(payload: bytes) -> None:
    """Raises ValueError for a map of many keys in a long payload: keys with one hash take quadratic time to read.

    It walks over the items' heads and looks at nothing else; the decoder refuses what is wrong with them.
    """
    at = 0 if len(payload) > _QUICK else len(payload)
    while at < len(payload):
        major, argument = payload[at] >> 5, payload[at] & 31
        width = _ARGUMENT_BYTES.get(argument, 0)
        if width:
            argument = int.from_bytes(payload[at + 1 : at + 1 + width], "big")
        if major == _MAP and argument > _MOST_PAIRS:
            raise ValueError(f"a map of {argument} pairs")
        at += 1 + width + (argument if major in (_BYTES, _TEXT) else 0)


def read_cbor(payload: bytes) -> Plain:
    """As `parse_cbor`, of a payload whose length has been checked."""
    try:
        check_maps(payload)
        plain, end = cbor2.loads(
            b"".join((_PAIR, payload, _END_ITEM)),
            max_depth=_MAX_DEPTH + 1,
            allow_indefinite=False,
            allow_duplicate_keys=False,
            semantic_decoders=NO_TAGS,
        )
    except (ValueError, cbor2.CBORError, RecursionError) as error:
        raise PayloadError(f"payload: not CBOR: {error}") from error
    if end != _END:
        raise PayloadError("payload: bytes behind the end of the message")
    return plain
