"""The drone's copy of its autopilot's parameters: read on request, and proven by hash (section 17)."""

from __future__ import annotations

from typing import Any

from ..errors import PayloadError
from ..protocol.bulk import Unchanged
from ..protocol.parameters import ParameterSet
from .effects import Transmit
from .mavlink.mission_protocol import Exchange
from .mavlink.parameter_protocol import SetReading, has_hash, parameter_of
from .mavlink.vehicle import Vehicle
from .runs import Output

FRESH_MS = 60_000
"""How long a set counts as the autopilot's after it was read, if the autopilot gives no hash of it."""
SURE_MS = 1000
"""The same if it gives one, which is then requested again."""
MOST_GIVEN = 4
"""How many of the newest sets given to stations are kept: a station that has one is given only the changes."""


class ParameterCopy:
    """One autopilot's parameters. `kept` is the set that a station was given in an earlier session."""

    def __init__(self, vehicle: Vehicle, kept: ParameterSet | None = None) -> None:
        self._vehicle = vehicle
        self._set = kept
        self._given = [kept] if kept is not None else []
        self._total: int | None = None
        self._proven_ms: int | None = None
        """When the set was last proven to be the autopilot's, if it was."""
        self._is_wanted = False
        self._error: tuple[str, int] | None = None
        self._proof: Exchange | None = None
        self._reading: SetReading | None = None
        self._restarts = vehicle.boots.restarts

    @property
    def newest_given(self) -> ParameterSet | None:
        """The set that a station was given last."""
        return self._given[-1] if self._given else None

    def fetch(self, now_ms: int, known: bytes | None = None) -> bytes | str | Unchanged | None:
        """The set, packed, or its changes since the set `known`; the reason for having none; None while it is read."""
        if not self._vehicle.is_alive(now_ms):
            return "no_autopilot"
        if self._set is not None and self._proven_ms is not None and now_ms - self._proven_ms <= self._counts_ms():
            return self._packed(self._set, known)
        error, self._error = self._error, None
        if error is not None and now_ms - error[1] <= SURE_MS:
            return error[0]
        self._is_wanted = True
        return None

    def on_message(self, message: Any, now_ms: int) -> list[Output]:
        """A message of the autopilot, which may show a changed parameter, whoever set it."""
        self._notice_restart()
        if not self._vehicle.is_own(message):
            return []
        out: list[Any] = []
        if self._proof is not None:
            out += [step.message for step in self._proof.on_message(message, now_ms)]
        if message.get_type() == "PARAM_VALUE":
            self._fold(message)
            if self._reading is not None:
                out += self._reading.on_value(message, now_ms)
        return [Transmit(one) for one in out] + self._go_on(now_ms)

    def tick(self, now_ms: int) -> list[Output]:
        """Requests that are due, and their repetitions."""
        self._notice_restart()
        out: list[Any] = []
        if self._proof is not None:
            out += [step.message for step in self._proof.tick(now_ms)]
        if self._reading is not None:
            out += self._reading.due(now_ms)
        return [Transmit(one) for one in out] + self._go_on(now_ms)

    def _go_on(self, now_ms: int) -> list[Output]:
        """Finish a step and begin the next: a proof by hash if there is a set to prove, otherwise a reading."""
        if self._proof is not None and self._proof.is_over:
            is_same, self._proof = self._proof.result, None
            if is_same:
                self._is_wanted, self._proven_ms = False, now_ms
                return []
            return self._read(now_ms)
        if self._reading is not None and self._reading.is_over:
            reading, self._reading = self._reading, None
            self._is_wanted = False
            if reading.found is None:
                self._error = (reading.error or "", now_ms)
            else:
                self._set, self._total, self._proven_ms = reading.found, reading.total, now_ms
            return []
        if not self._is_wanted or self._proof is not None or self._reading is not None:
            return []
        number = self._vehicle.autopilot.hash_check(self._set) if self._set is not None else None
        if number is None:
            return self._read(now_ms)
        self._proof = Exchange(has_hash(self._vehicle.system_id, number))
        return [Transmit(step.message) for step in self._proof.begin(now_ms)]

    def _read(self, now_ms: int) -> list[Output]:
        self._reading = SetReading(self._vehicle.system_id, self._vehicle.autopilot.bytewise)
        return [Transmit(one) for one in self._reading.begin(now_ms)]

    def _fold(self, message: Any) -> None:
        if self._set is None or self._vehicle.heartbeat_ms is None:  # the first heartbeat shows the autopilot's kind
            return
        if self._total is not None and message.param_count != self._total:
            self._proven_ms = None
        value = parameter_of(message, self._vehicle.autopilot.bytewise)
        if value is not None and self._set.parameters.get(value.name, value) != value:
            self._set = self._set.with_one(value)

    def _packed(self, found: ParameterSet, known: bytes | None) -> bytes | str | Unchanged:
        base = next((one for one in self._given if one.hash == known), None)
        try:
            data = Unchanged(found.hash) if known == found.hash else found.packed(base)
        except PayloadError:  # the changes since another firmware's set may exceed the whole set
            data = found.packed()
        self._given = [*(one for one in self._given if one.hash != found.hash), found][-MOST_GIVEN:]
        return data

    def _counts_ms(self) -> int:
        assert self._set is not None
        return FRESH_MS if self._vehicle.autopilot.hash_check(self._set) is None else SURE_MS

    def _notice_restart(self) -> None:
        """After a restart of the autopilot, distrust the set until it is proven or read again."""
        if self._restarts != self._vehicle.boots.restarts:
            self._restarts = self._vehicle.boots.restarts
            self._is_wanted = self._is_wanted or self._reading is not None or self._proof is not None
            self._proof = self._reading = self._proven_ms = None
