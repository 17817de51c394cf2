"""CBOR as payloads are written and read: canonical, of bounded length and depth, without tags."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from typing import Any, NoReturn

import cbor2

from ..errors import PayloadError
from .values import Plain

MAX_PAYLOAD = 61_440
"""Bytes; a longer payload is refused unread. The rankings of 250 drones in JSON are shorter."""
_MAX_DEPTH = 8


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


def read_cbor(payload: bytes) -> Plain:
    """As `parse_cbor`, of a payload whose length has been checked."""
    stream = BytesIO(payload)
    try:
        plain = cbor2.CBORDecoder(
            stream,
            max_depth=_MAX_DEPTH,
            allow_indefinite=False,
            allow_duplicate_keys=False,
            semantic_decoders=NO_TAGS,
        ).decode()
    except (ValueError, cbor2.CBORError, RecursionError) as error:
        raise PayloadError(f"payload: not CBOR: {error}") from error
    if stream.tell() != len(payload):
        raise PayloadError("payload: bytes behind the end of the message")
    return plain
