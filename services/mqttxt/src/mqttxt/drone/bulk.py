"""Objects in pieces at the drone: those that a station stages, and those that it fetches (protocol, section 16)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ..core.channel import Channel
from ..core.effects import Inbound
from ..core.session_owners import SessionOwners
from ..errors import PayloadError
from ..protocol.bulk import (
    MOST_BYTES,
    PIECE_BYTES,
    Answer,
    BulkAnswer,
    BulkAsk,
    Get,
    Have,
    Making,
    Partial,
    Piece,
    Put,
    Range,
    Refused,
    Unchanged,
)
from ..protocol.codec import decode
from ..protocol.logs import FlightLog
from ..protocol.plans import PLAN, hash_of
from ..protocol.topics import FogSide
from ..security.cose import Envelope
from .effects import Effect
from .log_work import LoadLog, LogLoaded
from .logs.reader import LogReader

MOST_STAGED = 4
MOST_STAGED_BYTES = 256 * 1024
"""The limits of all staged objects together; the one that was used longest ago makes room."""
KEPT_MS = 600_000
"""How long an unused object stays."""
MOST_BYTES_OF = {PLAN: 64 * 1024}
"""The greatest size of an object of each kind that can be staged."""
Source = Callable[[int, bytes | None], bytes | str | Unchanged | None]
"""Takes the time, ms, and the station's hash; gives the newest object, or why there is none; None while it is made."""


@dataclass
class _Staged:
    part: Partial
    touched_ms: int


@dataclass
class BulkStore:
    """The objects of one UAV client, only in memory: after its restart a station stages again.

    `sources` give the objects to fetch, by their kind; `logs` reads the autopilot's logs, which are on the disk.
    """

    sources: dict[str, Source] = field(default_factory=dict)
    logs: LogReader | None = None
    _staged: dict[bytes, _Staged] = field(default_factory=dict)
    _given: dict[str, tuple[bytes, bytes]] = field(default_factory=dict)
    """The newest fetched object of each kind: its hash and its bytes."""
    _awaiting: dict[str, tuple[BulkAsk, Get]] = field(default_factory=dict)
    """The newest request for each kind whose object is being made."""
    _awaited_log: tuple[FlightLog, BulkAsk] | None = None
    """The log that a station waits for, and its newest request."""

    def on_ask(self, message: BulkAsk, now_ms: int) -> list[BulkAnswer | LoadLog]:
        """The answers to a station's message; none while the requested object is being made or loaded."""
        log = FlightLog.of_kind(message.kind) if self.logs is not None else None
        if isinstance(message.ask, Put):
            answers: list[Answer] = [self._put(message.kind, message.ask, now_ms)]
        elif log is not None and message.ask.hash is not None:
            return [LoadLog(message, message.ask, message.ask.hash, log)]
        elif log is not None:
            answers = self._get_log(log, message, now_ms)
        else:
            answers = self._get(message, message.ask, now_ms)
        return [_answered(message, answer) for answer in answers]

    def tick(self, now_ms: int) -> list[BulkAnswer]:
        """Answers with objects that are now ready. Unused staged objects are dropped."""
        if self._staged:
            self._staged = {hash: one for hash, one in self._staged.items() if now_ms - one.touched_ms <= KEPT_MS}
        out: list[BulkAnswer] = []
        for kind, (message, get) in list(self._awaiting.items()):
            answer = self._newest(kind, get.known, now_ms)
            if answer is not None:
                del self._awaiting[kind]
                out.append(_answered(message, answer))
        if self._awaited_log is not None:
            log, message = self._awaited_log
            of_log = self._of_log(log)
            if not isinstance(of_log, Making):
                self._awaited_log = None
                out.append(_answered(message, of_log))
        return out

    def staged(self, hash: bytes) -> bytes | None:
        """The object with that hash, if all of it was staged."""
        found = self._staged.get(hash)
        return found.part.data if found is not None and found.part.is_whole else None

    def _put(self, kind: str, put: Put, now_ms: int) -> Have | Refused:
        longest = MOST_BYTES_OF.get(kind)
        if longest is None:
            return Refused("unknown_kind", put.hash)
        if put.size > longest:
            return Refused(f"too_long, {longest}", put.hash)
        found = self._staged.get(put.hash)
        if found is None:
            self._make_room(put.size)
            found = self._staged[put.hash] = _Staged(Partial(put.size), now_ms)
        found.touched_ms = now_ms
        if found.part.size != put.size or not (found.part.is_whole or found.part.put(put.offset, put.data)):
            del self._staged[put.hash]
            return Refused("inconsistent", put.hash)
        if found.part.is_whole and hash_of(found.part.data) != put.hash:
            del self._staged[put.hash]
            return Refused("wrong_hash", put.hash)
        return Have(put.hash, put.size, found.part.ranges)

    def _make_room(self, size: int) -> None:
        oldest_first = sorted(self._staged, key=lambda hash: self._staged[hash].touched_ms)
        for hash in oldest_first:
            used = sum(one.part.size for one in self._staged.values())
            if len(self._staged) < MOST_STAGED and used + size <= MOST_STAGED_BYTES:
                return
            del self._staged[hash]

    def _get(self, message: BulkAsk, get: Get, now_ms: int) -> list[Answer]:
        if get.hash is None:
            answer = self._newest(message.kind, get.known, now_ms)
            if answer is None:
                self._awaiting[message.kind] = (message, get)
            return [] if answer is None else [answer]
        hash, data = self._given.get(message.kind, (b"", b""))
        if hash != get.hash:
            return [Refused("unknown_hash", get.hash)]
        end = min(get.offset + get.length, len(data))
        return [
            Piece(hash, len(data), start, data[start : min(start + PIECE_BYTES, end)])
            for start in range(get.offset, end, PIECE_BYTES)
        ]

    def _get_log(self, log: FlightLog, message: BulkAsk, now_ms: int) -> list[Answer]:
        """Start reading a log and answer its progress; the final answer follows."""
        assert self.logs is not None
        self.logs.want(log, now_ms)
        self._awaited_log = (log, message)
        return [self._of_log(log)]

    def _of_log(self, log: FlightLog) -> Have | Making | Refused:
        assert self.logs is not None
        found = self.logs.progress(log)
        if isinstance(found, str):
            return Refused(found)
        return found if isinstance(found, Making) else Have(found.hash, found.size, (Range(0, found.size),))

    def _newest(self, kind: str, known: bytes | None, now_ms: int) -> Have | Refused | Unchanged | None:
        """Answer with the newest object of a kind, and keep it until the next request; None while it is made."""
        source = self.sources.get(kind)
        if source is None:
            return Refused("unknown_kind")
        data = source(now_ms, known)
        if data is None or isinstance(data, Unchanged):
            return data
        if isinstance(data, str) or len(data) > MOST_BYTES:
            return Refused(data if isinstance(data, str) else "too_long")
        hash = hash_of(data)
        self._given[kind] = (hash, data)
        return Have(hash, len(data), (Range(0, len(data)),))


def _answered(ask: BulkAsk, answer: Answer) -> BulkAnswer:
    """An answer with the fields that identify its request (R12.22)."""
    return BulkAnswer(gs_session=ask.gs_session, kind=ask.kind, nonce=ask.nonce, answer=answer)


@dataclass(frozen=True)
class BulkPort:
    """The messages about objects. Only the station in control is served, so that others cost nothing."""

    drone: int
    channel: Channel
    topics: FogSide
    owners: SessionOwners
    store: BulkStore

    def on_message(self, message: Inbound, holder_session: int | None, now_ms: int) -> list[Effect]:
        """A piece or a request. Raises PayloadError if it is not of `holder_session`."""
        ask = self._opened(message)
        if holder_session is None or ask.gs_session != holder_session:
            raise PayloadError(f"object of session {ask.gs_session:08x}: expected the station in control", "outsiders")
        said = self.store.on_ask(ask, now_ms)
        loads = [one for one in said if isinstance(one, LoadLog)]
        return [*loads, *self._published([one for one in said if isinstance(one, BulkAnswer)])]

    def on_loaded(self, loaded: LogLoaded) -> list[Effect]:
        """Publish the bytes of a log that a station has requested."""
        answers: list[Answer] = [Refused("unknown_hash", loaded.hash)]
        if loaded.data is not None:
            data, offset = loaded.data, loaded.get.offset
            answers = [
                Piece(loaded.hash, loaded.size, offset + start, data[start : start + PIECE_BYTES])
                for start in range(0, len(data), PIECE_BYTES)
            ]
        return self._published([_answered(loaded.ask, answer) for answer in answers])

    def tick(self, now_ms: int) -> list[Effect]:
        return self._published(self.store.tick(now_ms))

    def _opened(self, message: Inbound) -> BulkAsk:
        """The message. Raises PayloadError if it is signed and session or rights are not the signer's."""
        seal = self.channel.seal
        if seal is None:
            return decode(BulkAsk, message.payload)
        signed = seal.open_of_station(
            self.channel.signed_topic(message.topic), Envelope.parse(message.payload)
        ).before_its_end()
        ask, rights = decode(BulkAsk, signed.payload), signed.certificate.rights
        may = rights.may_command(self.drone) and (rights.upload_plan or not isinstance(ask.ask, Put))
        if not may or not self.owners.is_of(ask.gs_session, signed.signer):
            raise PayloadError(f"object of {signed.signer}: expected its own session and the right", "foreign_session")
        return ask

    def _published(self, answers: list[BulkAnswer]) -> list[Effect]:
        topic = self.topics.bulk_answer(self.drone)
        return [self.channel.publish(topic, answer, qos=0) for answer in answers]
