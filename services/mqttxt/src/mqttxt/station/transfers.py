"""Objects that travel in pieces, at the station: staged at a drone, or fetched from it (protocol, section 16).

Nothing here has a deadline. After a broken connection only the lost pieces are sent again, once the drone is reachable:
its answers say which have arrived.
"""

from __future__ import annotations

import secrets
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from ..core.channel import Channel
from ..core.effects import Effect, Log, Publish
from ..core.settings import RESEND_FIRST_MS, RESEND_LAST_MS
from ..protocol.bulk import (
    MOST_BYTES,
    PIECE_BYTES,
    WINDOW_BYTES,
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
from ..protocol.codec import encode
from ..protocol.plans import hash_of
from ..protocol.topics import FogSide
from .fog import LINK, FogView

UNKNOWN_MS = 2 * RESEND_FIRST_MS
"""How long to wait for an answer before a round trip is known."""
ATTEMPTS = 3
"""How often a transfer is attempted at most, if its object arrives with a wrong hash or is no longer known."""


@dataclass
class Flight:
    """The unanswered pieces: when each was sent, by its offset, in the order of sending.

    A piece that was sent twice shows no round trip: its answer may belong to either.
    """

    pieces: dict[int, int] = field(default_factory=dict)
    pause_ms: int = UNKNOWN_MS
    _given_up: set[int] = field(default_factory=set)

    @property
    def has_room(self) -> bool:
        return len(self.pieces) < WINDOW_BYTES // PIECE_BYTES

    def answered(self, offset: int, now_ms: int) -> None:
        """A piece was answered; the unanswered ones that were sent before it count as lost."""
        if offset not in self.pieces:
            return
        if offset not in self._given_up:
            self.pause_ms = max(RESEND_FIRST_MS, 2 * (now_ms - self.pieces[offset]))
        while (earlier := next(iter(self.pieces))) != offset:
            self._lose(earlier)
        del self.pieces[offset]

    def give_up(self, now_ms: int) -> None:
        """Where a piece is unanswered for too long, count all as lost, and wait longer for the next answers."""
        if any(now_ms - sent_ms >= self.pause_ms for sent_ms in self.pieces.values()):
            for offset in list(self.pieces):
                self._lose(offset)
            self.pause_ms = max(self.pause_ms, min(2 * self.pause_ms, RESEND_LAST_MS))

    def _lose(self, offset: int) -> None:
        del self.pieces[offset]
        self._given_up.add(offset)


class Transfer(ABC):
    """The transfer of one object to or from one drone. `error` is why it failed.

    All its requests carry `nonce`, and so do their answers: an answer from before is not taken for one (R12.22).
    """

    def __init__(self, fog: FogView, drone: int, kind: str) -> None:
        self.fog, self.drone, self.kind = fog, drone, kind
        self.nonce = secrets.randbelow(2**32)
        self.is_over = False
        self.error: str | None = None
        self._flight = Flight()

    def __str__(self) -> str:
        return f"drone {self.drone}: {self.kind}"

    @property
    def has_news(self) -> bool:
        """Whether there is news for the caller that waits: that the transfer is over, or its progress."""
        return self.is_over

    def end(self, error: str | None = None) -> None:
        self.is_over, self.error = True, error

    def due(self, now_ms: int) -> list[Put | Get]:
        """The requests to send now."""
        self._flight.give_up(now_ms)
        return [] if self.is_over else self._next(now_ms)

    @abstractmethod
    def take(self, answer: Answer, now_ms: int) -> None:
        """The drone's answer."""

    @abstractmethod
    def _next(self, now_ms: int) -> list[Put | Get]: ...


class Staging(Transfer):
    """Sends an object to a drone until the drone has all of it.

    `told` is the `done` that the caller has seen. The caller sets it; where none does, there is always news.
    """

    def __init__(self, fog: FogView, drone: int, kind: str, data: bytes) -> None:
        super().__init__(fog, drone, kind)
        self.hash = hash_of(data)
        self.told = -1
        self._data = data
        self._arrived = Partial(len(data))
        self._attempts = 0

    @property
    def done(self) -> int:
        """How many of its bytes the drone has, by its newest answer."""
        return sum(has.end - has.start for has in self._arrived.ranges)

    @property
    def has_news(self) -> bool:
        return self.is_over or self.done != self.told

    def take(self, answer: Answer, now_ms: int) -> None:
        if isinstance(answer, Piece | Unchanged | Making) or answer.hash != self.hash:
            return
        if isinstance(answer, Refused):
            self._refused(answer.reason)
            return
        self._arrived = Partial(len(self._data))
        for has in answer.ranges:
            self._arrived.put(has.start, self._data[has.start : has.end])
            for offset in [offset for offset in self._flight.pieces if has.start <= offset < has.end]:
                self._flight.answered(offset, now_ms)
        if self._arrived.is_whole:
            self.end()

    def _refused(self, reason: str) -> None:
        """Begin anew where the drone put the object together wrong; any other refusal ends the transfer."""
        self._attempts += 1
        if reason not in ("wrong_hash", "inconsistent") or self._attempts >= ATTEMPTS:
            self.end(reason)
        self._arrived, self._flight = Partial(len(self._data)), Flight()

    def _next(self, now_ms: int) -> list[Put | Get]:
        out: list[Put | Get] = []
        for offset, length in _pieces(self._arrived.missing()):
            if offset not in self._flight.pieces and self._flight.has_room:
                self._flight.pieces[offset] = now_ms
                piece = self._data[offset : offset + length]
                out.append(Put(self.hash, len(self._data), offset, piece))
        return out


class Fetching(Transfer):
    """Fetches a drone's newest object of a kind. `data` has it once the transfer is over without an error.

    `known` is the hash of the object that the station has; `data` is then the change since, empty where there is none.
    """

    def __init__(self, fog: FogView, drone: int, kind: str, known: bytes | None = None) -> None:
        super().__init__(fog, drone, kind)
        self.data = b""
        self._known = known
        self._hash: bytes | None = None
        self._part: Partial | None = None
        self._attempts = 0

    def take(self, answer: Answer, now_ms: int) -> None:
        if isinstance(answer, Refused):
            self._refused(answer)
        elif isinstance(answer, Unchanged):
            if self._part is None and answer.known == self._known:
                self.end()
        elif isinstance(answer, Have):
            if answer.size > MOST_BYTES:
                self.end("too_long")
            elif self._part is None:
                self._hash, self._part, self._flight = answer.hash, Partial(answer.size), Flight()
        elif (
            isinstance(answer, Piece)
            and self._part is not None
            and answer.hash == self._hash
            and answer.size == self._part.size
        ):
            self._flight.answered(answer.offset, now_ms)
            self._part.put(answer.offset, answer.data)
            if self._part.is_whole:
                self._finish(self._part.data)

    def _finish(self, data: bytes) -> None:
        if hash_of(data) == self._hash:
            self.data = data
            self.end()
        else:
            self._begin_anew("wrong_hash")

    def _refused(self, answer: Refused) -> None:
        if answer.hash is None:
            self.end(answer.reason)
        elif answer.hash == self._hash:  # the drone has another one by now, or was restarted
            self._begin_anew(answer.reason)

    def _begin_anew(self, reason: str) -> None:
        self._attempts += 1
        if self._attempts >= ATTEMPTS:
            self.end(reason)
        self._hash, self._part, self._flight = None, None, Flight()

    def _next(self, now_ms: int) -> list[Put | Get]:
        if self._part is None:
            if self._flight.pieces:
                return []
            self._flight.pieces[0] = now_ms
            return [Get(0, 0, known=self._known)]
        out: list[Put | Get] = []
        for offset, length in _pieces(self._part.missing()):
            if offset not in self._flight.pieces and self._flight.has_room:
                self._flight.pieces[offset] = now_ms
                out.append(Get(offset, length, self._hash))
        return out


class Transfers:
    """The transfers of one station session: one at a time for each drone, in the order in which they were begun."""

    def __init__(self, session: int, channel: Channel) -> None:
        self._session = session
        self._channel = channel
        self._queue: list[Transfer] = []

    def begin(self, transfer: Transfer, now_ms: int) -> list[Effect]:
        """Queue a transfer; returns the requests that may be sent now."""
        self._queue.append(transfer)
        return self.tick(now_ms)

    def on_answer(self, fog: FogView, drone: int, message: BulkAnswer, now_ms: int) -> list[Effect]:
        """Take a drone's answer; one with another session is another station's."""
        if message.gs_session != self._session:
            return []
        transfer = next((one for one in self._queue if (one.fog.number, one.drone) == (fog.number, drone)), None)
        if transfer is None or (transfer.kind, transfer.nonce) != (message.kind, message.nonce):
            return []
        transfer.take(message.answer, now_ms)
        refused = message.answer if isinstance(message.answer, Refused) else None
        out: list[Effect] = [Log("object_refused", f"drone {drone}: {refused.reason}")] if refused is not None else []
        return out + self.tick(now_ms)

    def tick(self, now_ms: int) -> list[Effect]:
        """The requests that are due to each reachable drone; a transfer that is over makes room for the next."""
        self._queue = [transfer for transfer in self._queue if not transfer.is_over]
        out: list[Effect] = []
        busy: set[tuple[int, int]] = set()
        for transfer in self._queue:
            key = (transfer.fog.number, transfer.drone)
            view = transfer.fog.drones.get(transfer.drone)
            if key not in busy and transfer.fog.registered and view is not None and view.reachable:
                out += [self._publish(transfer, ask) for ask in transfer.due(now_ms)]
            busy.add(key)
        return out

    def _publish(self, transfer: Transfer, ask: Put | Get) -> Publish:
        """Publish a request, signed for the drone where messages are signed."""
        message = BulkAsk(gs_session=self._session, kind=transfer.kind, nonce=transfer.nonce, ask=ask)
        payload = encode(message, self._channel.settings.encoding)
        if self._channel.seal is not None:
            payload = self._channel.seal.sign(FogSide().bulk(transfer.drone), payload).encode()
        return Publish(LINK, transfer.fog.topics.drone_bulk(transfer.drone), payload, qos=0)


def _pieces(ranges: list[Range]) -> list[tuple[int, int]]:
    """Split missing ranges into pieces, each with its start and its length, on one grid."""
    out = []
    for missing in ranges:
        start = missing.start
        while start < missing.end:
            end = min(missing.end, (start // PIECE_BYTES + 1) * PIECE_BYTES)
            out.append((start, end - start))
            start = end
    return out
