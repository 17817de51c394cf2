"""Writes and reads payloads as CBOR: canonical, of bounded length and depth, without tags."""

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
"""The most pairs of a map; the only map in use, COSE's header, has three."""
_QUICK = 2048
"""Payloads of at most this many bytes cost little to read, whatever they contain."""
_ARGUMENT_BYTES = {24: 1, 25: 2, 26: 4, 27: 8}
"""The length of an item's argument by the low five bits of its first byte (RFC 8949, section 3)."""
_BYTES, _TEXT, _MAP = 2, 3, 5
_PAIR = b"\x82"
_END = secrets.token_bytes(16)
_END_ITEM = b"\x50" + _END
"""A secret item appended to each payload: reading it back shows that the payload was exactly one whole item.

cbor2 gives the end of an item only for a stream, which takes twice as long to read.
"""


class _NoTags(dict[int, Callable[..., NoReturn]]):
    """Refuses every tag. No message has one, and decoding a tagged value can cost anything: a regular expression (35)
    of 60 kB takes half a minute, and some hundred bytes of shared references (28, 29) fill the memory.
    """

    def __missing__(self, tag: int) -> Callable[..., NoReturn]:
        return _refuse_tag


def _refuse_tag(*_: Any) -> NoReturn:
    raise ValueError("a tag")


NO_TAGS = _NoTags()


def encode_plain(plain: Plain) -> bytes:
    """The CBOR of a message's array, with floats in the shortest form that loses nothing."""
    return cbor2.dumps(plain, canonical=True)


def check_length(payload: bytes) -> None:
    """Raises PayloadError for a payload that is empty or too long, in either form."""
    if not payload:
        raise PayloadError("payload: expected CBOR or JSON, got nothing", "empty")
    if len(payload) > MAX_PAYLOAD:
        raise PayloadError(f"payload: expected at most {MAX_PAYLOAD} bytes, got {len(payload)}", "too_long")


def parse_cbor(data: bytes) -> Plain:
    """The value of one CBOR item. Raises PayloadError for anything else."""
    if not 0 < len(data) <= MAX_PAYLOAD:
        raise PayloadError(f"payload: expected 1 to {MAX_PAYLOAD} bytes, got {len(data)}", "too_long")
    return read_cbor(data)


def check_maps(payload: bytes) -> None:
    """Raises ValueError for a map of many keys in a long payload: keys with equal hashes take quadratic time to read.

    It only walks over the items' heads; the decoder refuses malformed ones.
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
    """As `parse_cbor`, for a payload whose length has been checked."""
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
