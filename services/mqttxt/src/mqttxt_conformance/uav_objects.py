"""What a UAV client reads of its autopilot for a station: parameters (section 17) and flight logs (section 18)."""

from __future__ import annotations

import secrets
import zlib
from hashlib import sha256
from typing import Any

import cbor2

from mqttxt.protocol.bulk import BulkAsk, Get
from mqttxt.protocol.codec import encode

from . import shapes
from .registry import Broken, NotTested, expect
from .uav_kit import LEASE_MS, UavKit

_AGAIN_S = 2.0
_PIECE_BYTES = 512
_HASH_BYTES = 16
_HEAD = 5
"""The fields of a bulk-answer in front of the answer's own."""

Answer = tuple[str, list[Any]]
"""The name of an answer, and its own fields."""


class Transfer:
    """A station in control that asks a UAV client for an object of a kind."""

    def __init__(self, kit: UavKit, session: int, kind: str) -> None:
        self._kit = kit
        self._session = session
        self._kind = kind
        self._nonce = secrets.randbelow(2**32)

    async def newest(self, limit_s: float, known: bytes | None = None) -> Answer:
        """The answer to a question for the newest object; asked again while it is made. Raises Broken without one."""
        first = len(self._kit.tap.heard)
        for _ in range(round(limit_s / _AGAIN_S)):
            found = await self.ask(Get(0, 0, None, known), besides="making")
            if found is not None:
                return found
        came = self._answers(first, "")
        raise Broken(f"a question for {self._kind}: {came[-1] if came else 'no answer'} in {limit_s:g} s")

    async def ask(self, ask: Get, besides: str = "") -> Answer | None:
        """Ask once; returns the first answer of another name than `besides`, None without one for `_AGAIN_S`."""
        mark = len(self._kit.tap.heard)
        message = BulkAsk(gs_session=self._session, kind=self._kind, nonce=self._nonce, ask=ask)
        self._kit.tap.publish(self._kit.topics.bulk(self._kit.drone), encode(message), qos=0)
        found: list[Answer] = await self._kit.tap.until(lambda: self._answers(mark, besides), _AGAIN_S)
        return found[0] if found else None

    def _answers(self, mark: int, besides: str) -> list[Answer]:
        found = []
        for heard in self._kit.tap.since(mark, self._kit.topics.bulk_answer(self._kit.drone)):
            fields, raw = shapes.read("bulk-answer", heard.payload), shapes.plain(heard.payload)
            if not isinstance(raw, list):
                raise NotTested("it answers in JSON; the kit reads objects in CBOR alone")
            if fields["nonce"] == self._nonce and fields["answer"] != besides:
                found.append((fields["answer"], raw[_HEAD:]))
        return found

    async def whole(self, told: Answer) -> bytes:
        """The object of a `have`, decompressed; raises Broken if it does not come, or has another hash."""
        name, fields = told
        expect(name == "have", f"{self._kind}: came {name} {fields}, expected have")
        named, size = fields[0], fields[1]
        data = b""
        while len(data) < size:
            length = min(_PIECE_BYTES, size - len(data))
            answer = await self.ask(Get(len(data), length, named)) or await self.ask(Get(len(data), length, named))
            expect(answer is not None and answer[0] == "piece", f"{self._kind} from {len(data)}: came {answer}")
            assert answer is not None
            _, _, offset, piece = answer[1]
            expect(offset == len(data) and piece, f"{self._kind} from {len(data)}: came a piece from {offset}")
            data += piece
        own = sha256(data).digest()[:_HASH_BYTES]
        expect(own == named, f"{self._kind}: hash {named.hex()}, of what came {own.hex()}")
        try:
            return zlib.decompress(data)
        except zlib.error as error:
            raise Broken(f"{self._kind}: {error}; expected RFC 1950") from error


async def in_control(kit: UavKit) -> int:
    """Give a new station control of the drone; returns its session."""
    session = kit.command().gs_session
    await kit.echo(holder_session=session, deadline_ms=kit.deadline(LEASE_MS))
    return session


def rows_of(data: bytes, at: int) -> list[Any]:
    """The list in field number `at` of an object; raises Broken."""
    try:
        rows = cbor2.loads(data)[at]
    except (cbor2.CBORError, IndexError, TypeError, KeyError) as error:
        raise Broken(f"object {data[:24].hex(' ')}: {error}") from error
    if not isinstance(rows, list):
        raise Broken(f"object {shapes.shown(data)}: expected a list in field {at}")
    return rows
