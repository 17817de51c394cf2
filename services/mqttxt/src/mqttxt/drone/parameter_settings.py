"""The commands that set a parameter of the autopilot, one after the other (docs/protocol.md, section 17)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..protocol.commands import SetParameter
from ..protocol.messages import CommandId, Word
from ..protocol.words import NOT_IN_CONTROL
from .effects import Transmit
from .mavlink.guarded_parameters import is_guarded
from .mavlink.mission_protocol import Exchange, Step
from .mavlink.parameter_protocol import assign, read_message
from .mavlink.plans import CannotExecute
from .mavlink.raw import Limits
from .mavlink.vehicle import Vehicle
from .runs import Output, Said
from .write_permit import WritePermit


@dataclass(eq=False)
class _Setting:
    """A parameter that is being set. `is_written`: the autopilot may have the value by now.

    `is_outdated`: it is read instead of being written again, because the process stood still.
    """

    id: CommandId
    name: str
    exchange: Exchange
    deadline_ms: int
    ends_ms: int
    restarts: int
    is_written: bool = False
    is_outdated: bool = False
    late_ms: int | None = None


class ParameterSettings:
    """Sets parameters of one autopilot, within `limits`, as long as `permit` lets it write."""

    def __init__(self, vehicle: Vehicle, limits: Limits, permit: WritePermit) -> None:
        self._vehicle = vehicle
        self._limits = limits
        self._permit = permit
        self._settings: list[_Setting] = []

    def start(
        self, command_id: CommandId, command: SetParameter, deadline_ms: int, limit_ms: int, now_ms: int
    ) -> list[Output]:
        """Begin an admitted command; it may have to wait until another one ends."""
        if is_guarded(command.parameter) and command.parameter not in self._limits.parameters:
            return [Said(command_id, Word.DENIED, "parameter_not_enabled")]
        if not self._vehicle.is_alive(now_ms):
            return [Said(command_id, Word.DENIED, "no_autopilot")]
        name, bytewise = command.parameter, self._vehicle.autopilot.bytewise
        steps = assign(self._vehicle.system_id, name, command.value, bytewise, self._limits.range_of(name))
        restarts = self._vehicle.boots.restarts
        self._settings.append(_Setting(command_id, name, Exchange(steps), deadline_ms, now_ms + limit_ms, restarts))
        return self._begin_next(now_ms)

    def owns(self, command_id: CommandId) -> bool:
        """Whether a write was for one of these commands."""
        return any(one.id == command_id for one in self._settings)

    def on_transmitted(self, command_id: CommandId, now_ms: int) -> list[Output]:
        """The parameter was written."""
        one = next(one for one in self._settings if one.id == command_id)
        one.is_written = True
        if now_ms > one.deadline_ms:
            one.late_ms = max(one.late_ms or 0, now_ms - one.deadline_ms)
        return []

    def stood_still(self) -> None:
        """The process stood still: what was written may have been answered, and changed by a pilot since."""
        for one in self._settings:
            one.is_outdated = one.is_written

    def on_refused(self, command_id: CommandId, late: bool, now_ms: int) -> list[Output]:
        """It was not written: past the deadline (`late`), or because the autopilot's link refused it."""
        one = next(one for one in self._settings if one.id == command_id)
        return self._end(one, Word.EXPIRED, None, now_ms) if late and not one.is_written else []

    def on_message(self, message: Any, now_ms: int) -> list[Output]:
        """A message of the autopilot."""
        one = self._settings[0] if self._settings else None
        if one is None or not self._vehicle.is_own(message):
            return []
        return self._write(one, one.exchange.on_message(message, now_ms), now_ms)

    def tick(self, now_ms: int) -> list[Output]:
        """Repetitions, limits, and the loss or restart of the autopilot."""
        out = self._begin_next(now_ms)
        one = self._settings[0] if self._settings else None
        if one is None:
            return out
        lost = "autopilot_restarted" if one.restarts != self._vehicle.boots.restarts else None
        lost = lost or ("autopilot_lost" if self._vehicle.is_lost(now_ms) else None)
        lost = lost or ("timeout" if now_ms >= one.ends_ms else None)
        if lost is not None:
            return out + self._end(one, Word.UNCONFIRMED if one.is_written else Word.DENIED, lost, now_ms)
        return out + self._write(one, one.exchange.tick(now_ms), now_ms)

    def _begin_next(self, now_ms: int) -> list[Output]:
        """Begin the first one, after the end of those that may not be written any more: thousands may wait."""
        out: list[Output] = []
        while self._settings and not self._settings[0].exchange.has_begun and not self._permit.is_leaving:
            one = self._settings[0]
            if now_ms <= one.deadline_ms and self._permit.has_control(one.id):
                return out + self._write(one, one.exchange.begin(now_ms), now_ms)
            word, reason = (Word.EXPIRED, None) if now_ms > one.deadline_ms else (Word.DENIED, NOT_IN_CONTROL)
            out.append(self._ended(one, word, reason))
        return out

    def _write(self, one: _Setting, steps: list[Step], now_ms: int) -> list[Output]:
        """Write steps: requests at any time, each copy of the value within the deadline and the station's control."""
        if any(step.changes for step in steps):
            if self._permit.is_leaving:
                return []
            if not self._permit.has_control(one.id):
                return self._end(one, Word.UNCONFIRMED if one.is_written else Word.DENIED, NOT_IN_CONTROL, now_ms)
        out: list[Output] = []
        for step in steps:
            if not step.changes:
                out.append(Transmit(step.message))
            elif one.is_outdated:
                out.append(Transmit(read_message(self._vehicle.system_id, one.name)))
            elif not self._permit.is_unsure():
                out.append(Transmit(step.message, one.deadline_ms, one.id))
        return out + (self._over(one, now_ms) if one.exchange.is_over else [])

    def _over(self, one: _Setting, now_ms: int) -> list[Output]:
        error = one.exchange.error
        if error is None:
            return self._end(one, Word.COMPLETED, None, now_ms)
        if not one.is_written:
            return self._end(one, Word.DENIED, str(error), now_ms)
        if isinstance(error, CannotExecute):  # the answer to the read-back does not show the value
            return self._end(one, Word.UNCONFIRMED, str(error), now_ms)
        if str(error) == "no_answer":
            return self._end(one, Word.UNCONFIRMED, "no_ack", now_ms)
        return self._end(one, Word.FAILED, str(error), now_ms)

    def _end(self, one: _Setting, word: Word, reason: str | None, now_ms: int) -> list[Output]:
        return [self._ended(one, word, reason), *self._begin_next(now_ms)]

    def _ended(self, one: _Setting, word: Word, reason: str | None) -> Said:
        one.exchange.stop()
        self._settings.remove(one)
        return Said(one.id, word, reason, late_ms=one.late_ms)
