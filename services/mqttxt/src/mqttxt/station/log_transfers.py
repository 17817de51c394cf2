"""A flight log's transfer from a drone: wait until the drone has it, then fetch its bytes in order (section 18)."""

from __future__ import annotations

from ..core.settings import RESEND_FIRST_MS
from ..protocol.bulk import PIECE_BYTES, WINDOW_BYTES, Answer, Get, Have, Making, Piece, Put, Refused
from ..protocol.logs import FlightLog
from .fog import FogView
from .transfers import Transfer

MOST_WAITING_BYTES = 65_536
"""No more is requested while this many received bytes are not on the disk yet."""
ALLOWANCE_BYTES = 8 * WINDOW_BYTES
"""The largest burst of requests after a time below the rate."""


class LogWait(Transfer):
    """Waits until a drone has a whole log; `hash` and `size` are then those of the compressed log.

    `done` is how many bytes the drone has read from its autopilot, `told` the `done` that the caller has seen.
    """

    def __init__(self, fog: FogView, drone: int, log: FlightLog) -> None:
        super().__init__(fog, drone, log.kind)
        self.hash, self.size = b"", 0
        self.done = self.told = 0
        self._next_ms = 0

    @property
    def has_news(self) -> bool:
        return self.is_over or self.done != self.told

    def take(self, answer: Answer, now_ms: int) -> None:
        """Take the drone's answer. `Making` shows, too, that the question has arrived."""
        if isinstance(answer, Refused) and answer.hash is None:
            self.end(answer.reason)
        elif isinstance(answer, Have):
            self.hash, self.size = answer.hash, answer.size
            self.end()
        elif isinstance(answer, Making):
            self.done = answer.done
            self._flight.answered(0, now_ms)
            self._next_ms = now_ms + RESEND_FIRST_MS

    def _next(self, now_ms: int) -> list[Put | Get]:
        if self._flight.pieces or now_ms < self._next_ms:
            return []
        self._flight.pieces[0] = now_ms
        return [Get(0, 0)]


class LogPieces(Transfer):
    """Fetches the bytes of a whole log from `start` on, which `take_out` returns in order.

    At most `most_bytes_s` are requested per second.
    """

    def __init__(self, waited: LogWait, start: int, most_bytes_s: int) -> None:
        super().__init__(waited.fog, waited.drone, waited.kind)
        self._hash, self._size = waited.hash, waited.size
        self._asked = self.arrived = start
        self._most_bytes_s = most_bytes_s
        self._allowed, self._allowed_ms = float(ALLOWANCE_BYTES), 0
        self._early: dict[int, bytes] = {}
        self._waiting = bytearray()

    @property
    def has_news(self) -> bool:
        """Whether bytes wait for `take_out`, or the transfer is over."""
        return bool(self._waiting) or self.is_over

    def take_out(self) -> bytes:
        """Remove and return the bytes that have arrived in order since the last call."""
        found = bytes(self._waiting)
        self._waiting.clear()
        return found

    def take(self, answer: Answer, now_ms: int) -> None:
        """Take the drone's answer. A drone that no longer has the log was restarted, or needed the room."""
        if isinstance(answer, Refused):
            if answer.hash in (None, self._hash):
                self.end(answer.reason)
            return
        if not isinstance(answer, Piece) or (answer.hash, answer.size) != (self._hash, self._size):
            return
        wanted = min(PIECE_BYTES, self._size - answer.offset)
        if answer.offset not in self._flight.pieces or len(answer.data) != wanted:
            return
        self._flight.answered(answer.offset, now_ms)
        self._early[answer.offset] = answer.data
        while self.arrived in self._early:
            data = self._early.pop(self.arrived)
            self._waiting += data
            self.arrived += len(data)
        if self.arrived == self._size:
            self.end()

    def _next(self, now_ms: int) -> list[Put | Get]:
        since_ms, self._allowed_ms = now_ms - self._allowed_ms, now_ms
        self._allowed = min(ALLOWANCE_BYTES, self._allowed + since_ms * self._most_bytes_s / 1000)
        out: list[Put | Get] = []
        for offset in range(self.arrived, min(self._size, self.arrived + WINDOW_BYTES), PIECE_BYTES):
            is_free = offset not in self._flight.pieces and offset not in self._early
            has_room = self._flight.has_room and len(self._waiting) < MOST_WAITING_BYTES
            if is_free and has_room and self._allowed >= PIECE_BYTES:
                self._allowed -= PIECE_BYTES
                self._flight.pieces[offset] = now_ms
                out.append(Get(offset, min(PIECE_BYTES, self._size - offset), self._hash))
        return out
