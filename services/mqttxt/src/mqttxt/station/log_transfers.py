"""A flight log on its way from a drone: whether the drone has it yet, then its bytes in their order (section 18)."""

from __future__ import annotations

from ..core.settings import RESEND_FIRST_MS
from ..protocol.bulk import PIECE_BYTES, WINDOW_BYTES, Answer, Get, Have, Making, Piece, Put, Refused
from ..protocol.logs import FlightLog
from .fog import FogView
from .transfers import Transfer

MOST_WAITING_BYTES = 65_536
"""What has come and is not on the disk yet, before no more is asked for."""
ALLOWANCE_BYTES = 8 * WINDOW_BYTES
"""What may be asked for at once after a while of less than the rate."""


class LogWait(Transfer):
    """Until a drone has a log as a whole: `hash` and `size` name it then, compressed.

    `done` is how many bytes it has read of its autopilot, `told` how many of them whoever waits knows of.
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
        """The drone's answer; that it is still reading says that it has heard the question."""
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
    """The bytes of a whole log from `start` on, which come out of `take_out` in their order.

    No more than `most_bytes_s` are asked for in a second.
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
        """Whether bytes have come that were not taken out, or none will any more."""
        return bool(self._waiting) or self.is_over

    def take_out(self) -> bytes:
        """The bytes behind those that were taken out before."""
        found = bytes(self._waiting)
        self._waiting.clear()
        return found

    def take(self, answer: Answer, now_ms: int) -> None:
        """The drone's answer. One that does not have the log any more was started anew, or needed the room."""
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
