"""Reads the command id from a payload that cannot be decoded, so that the command can be answered anyway."""

from __future__ import annotations

import json
from io import BytesIO
from typing import Any

import cbor2

from .cbor import MAX_PAYLOAD, NO_TAGS, check_maps
from .messages import CommandId


def identify(payload: bytes) -> CommandId | None:
    """The id in a malformed command, None if no id can be read."""
    if not 0 < len(payload) <= MAX_PAYLOAD:
        return None
    try:
        plain: Any = json.loads(payload) if payload[:1] == b"{" else _lenient(payload)
    except (ValueError, cbor2.CBORError, RecursionError):
        return None
    if isinstance(plain, dict):
        numbers = (plain.get("gs_session"), plain.get("seq"))
    elif isinstance(plain, list) and len(plain) >= 3:
        numbers = (plain[1], plain[2])
    else:
        return None
    session, seq = numbers
    if type(session) is not int or type(seq) is not int:
        return None
    if not (0 < session < 2**32 and 0 <= seq < 2**32):
        return None
    return CommandId(session, seq)


def _lenient(payload: bytes) -> Any:
    """The first CBOR item, whatever follows it."""
    check_maps(payload)
    return cbor2.CBORDecoder(BytesIO(payload), semantic_decoders=NO_TAGS).decode()
