"""The autopilot's acknowledgements and their effect on the open commands (docs/protocol.md, R5.6, R5.18)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from ..core.effects import Log
from ..protocol.commands import Offboard
from ..protocol.messages import Word
from ..protocol.states import FlightMode
from .interruptions import modes_shown
from .mavlink.mav_result import answered, percent_of, refusal
from .mavlink.plans import AUTOPILOT_COMPONENT
from .mavlink.vehicle import Vehicle
from .offboard import OffboardPilot
from .resting_numbers import AckKey, AnsweredWrite
from .runs import Output, Phase, Run, Runs, Said

UNEXPLAINED = "autopilot"
"""The reason of a refusal whose MAV_RESULT gives none."""
QUOTED = frozenset({UNEXPLAINED, refusal(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)[1]})
"""The reasons behind which the autopilot's text is quoted."""
WORDS_MS = 200
"""How long after a refusal the autopilot's STATUSTEXT may still give the reason."""
PROGRESS_MS = 1000
"""The shortest time between two percentages of a command; in between only the newest is kept."""

_FLIGHT_COMMANDS = frozenset(
    {
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_DO_REPOSITION,
        mavlink.MAV_CMD_DO_SET_MODE,
    }
)


@dataclass(frozen=True)
class _Held:
    """The last word on a refused command, the message number at its write, and the end of holding it back."""

    said: Said
    number: int
    until_ms: int


@dataclass(frozen=True)
class Acknowledgements:
    """Matches acknowledgements to open commands, and returns the words that follow."""

    vehicle: Vehicle
    runs: Runs
    pilot: OffboardPilot
    _held: list[_Held] = field(default_factory=list)

    def on_ack(self, message: Any, now_ms: int) -> list[Output]:
        keys = [(message.command, source) for source in answered(message, self.vehicle.system_id)]
        late = next((key for key in keys if self.runs.acks.is_late(key, now_ms)), None)
        run = self.runs.awaiting(*keys) if late is None else None
        commanded = AUTOPILOT_COMPONENT if run is None else run.plan.message.target_component
        if message.get_srcComponent() != commanded:
            return []
        if run is None:
            return self._on_unawaited(late or keys[0], keys, message.result, now_ms) if keys else []
        if message.result == mavlink.MAV_RESULT_IN_PROGRESS:
            return self._on_progress(run, percent_of(message), now_ms)
        run.acks += 1
        if message.result != mavlink.MAV_RESULT_ACCEPTED:
            return self._on_refusal(run, keys, message.result, now_ms)
        if run.sends > run.acks:
            self.rest(run, now_ms)
        if self.vehicle.answers_twice(run.plan.mav_cmd):
            self.runs.acks.expect_second(run.ack_key, run.id, now_ms)
        if run.plan.is_said_once:
            return [self.runs.end(run, Word.COMPLETED, observed=False)]
        return self.accept(run, now_ms)

    def rest(self, run: Run, now_ms: int) -> None:
        """Rest the run's key while its acknowledgements may still arrive."""
        self.runs.acks.rest(run.ack_key, run.id, run.sends - run.acks, now_ms)

    def accept(self, run: Run, now_ms: int) -> list[Output]:
        """The autopilot carries the command out from now on."""
        run.phase = Phase.RUNNING
        run.accepted_ms = now_ms
        run.accepted_number, run.restarts = self.vehicle.number, self.vehicle.boots.restarts
        mode = self.vehicle.seen(FlightMode, run.sent_number)  # PX4 may show it before it acknowledges
        run.entered_mode |= mode is not None and run.plan.modes is not None and mode.mode in run.plan.modes
        run.modes_before |= modes_shown(self.vehicle)
        if isinstance(run.command, Offboard):
            self.pilot.begin(run, now_ms)
        if run.plan.on_accepted is not None:
            run.plan.on_accepted(now_ms)
        out: list[Output] = [Said(run.id, Word.ACCEPTED, late_ms=run.late_ms), *self._supersede(run, now_ms)]
        newer = self.runs.newer(run)
        if newer is not None and newer.is_under_way:
            out.append(self.runs.end(run, Word.SUPERSEDED, by=newer.id))
        return out

    def tell_progress(self, run: Run, now_ms: int) -> list[Output]:
        """The newest percentage, if it differs from the published one, at most once per `PROGRESS_MS`."""
        if not run.in_progress or run.percent == run.told_percent or now_ms < run.told_percent_ms + PROGRESS_MS:
            return []
        return [self._progress(run, now_ms)]

    def _refusal(self, run: Run, result: int) -> tuple[Word, str | None]:
        """The last word for a refusal, with the autopilot's texts since the command was sent."""
        word, reason = refusal(result)
        if result == mavlink.MAV_RESULT_FAILED and self.vehicle.autopilot.refuses_as_failed:
            word = Word.DENIED
        text = self.vehicle.text_since(run.sent_number)
        reason = f"{reason}: {text}" if reason in QUOTED and text else reason
        if word.is_definite_no and (run.in_progress or run.phase is Phase.RUNNING):  # it was started
            return Word.FAILED, reason or word.label
        return word, reason

    def _on_refusal(self, run: Run, keys: Sequence[AckKey], result: int, now_ms: int) -> list[Output]:
        """The last word once every copy was refused: an unanswered copy, or one in progress, may be carried out.

        Runs that the acknowledgement may answer, by its `keys`, wait for the answers to all their copies, and for those
        to the client's own writes.
        """
        word, reason = self._refusal(run, result)
        run.refusals += 1
        if run.refused is None or run.refused[0].is_definite_no:
            run.refused = (word, reason)
        run.last_send_ms = now_ms
        sharing = self.runs.sharing(keys)
        rests = any(not self.runs.acks.is_free(key, now_ms) for key in keys if key != run.ack_key)
        if rests or any(one.sends > one.acks for one in sharing):
            return []
        return [said for one in sharing if one.refused is not None for said in self._refused(one, *one.refused, now_ms)]

    def _refused(self, run: Run, word: Word, reason: str | None, now_ms: int) -> list[Output]:
        """End a refused run; hold its last word back if the autopilot's text may follow."""
        earlier, said = self.unexplained(), self.runs.end(run, word, reason)
        if said.reason not in QUOTED or not self.vehicle.autopilot.explains_afterwards:
            return [*earlier, said]
        self._held.append(_Held(said, run.sent_number, now_ms + WORDS_MS))
        return earlier

    def unexplained(self) -> list[Output]:
        """End the waits for texts: a newer refusal's text follows, or the process ends."""
        words: list[Output] = [held.said for held in self._held]
        self._held.clear()
        return words

    def explained(self, now_ms: int) -> list[Output]:
        """The held-back last words whose reason has arrived or is no longer waited for."""
        out: list[Output] = []
        for held in list(self._held):
            text = self.vehicle.text_since(held.number)
            if text or now_ms >= held.until_ms:
                self._held.remove(held)
                out.append(replace(held.said, reason=f"{held.said.reason}: {text}") if text else held.said)
        return out

    def _on_unawaited(self, key: AckKey, keys: Sequence[AckKey], result: int, now_ms: int) -> list[Output]:
        """An acknowledgement that no command waits for: another copy's, a second one, or of the client's own write."""
        if result == mavlink.MAV_RESULT_IN_PROGRESS:
            return []
        expected, mav_cmd = self.runs.acks.take(key, now_ms), key[0]
        if expected is None:
            text = f"COMMAND_ACK of {mav_cmd} without an open command"
            return [Log("ack_unexpected", text)] if mav_cmd in _FLIGHT_COMMANDS else []
        is_accepted, is_second = result == mavlink.MAV_RESULT_ACCEPTED, expected.kind is AnsweredWrite.SECOND
        if is_accepted and not is_second and self.vehicle.answers_twice(mav_cmd):
            self.runs.acks.expect_second(key, expected.owner, now_ms)
        late = [Log("ack_discarded", f"late COMMAND_ACK of {mav_cmd}")] if expected.kind is AnsweredWrite.LATE else []
        run = self.runs.find(expected.owner) if expected.owner is not None else None
        if run is None:
            return [*late]
        if run.phase is Phase.PREPARING and run.preparation is not None:
            run.preparation.on_answer(is_accepted, is_second)
        elif run.phase is Phase.RUNNING and run.ack_key == key and not is_accepted:
            return [*late, *self._on_refusal_after_acceptance(run, keys, result, now_ms)]
        return [*late]

    def _on_refusal_after_acceptance(self, run: Run, keys: Sequence[AckKey], result: int, now_ms: int) -> list[Output]:
        """End an accepted run as refused, unless a heartbeat has shown its mode, or another copy may be carried out.

        The run also goes on while another one waits that the refusal may be of, by its `keys`.
        """
        if self.runs.sharing(keys):
            return []
        run.refusals += 1
        if run.entered_mode or run.refusals < run.sends:
            return []
        return self._refused(run, *self._refusal(run, result), now_ms)

    def _on_progress(self, run: Run, percent: int | None, now_ms: int) -> list[Output]:
        """The command is under way, and is not sent again."""
        run.percent = percent
        if run.in_progress:
            return self.tell_progress(run, now_ms)
        run.in_progress, run.restarts = True, self.vehicle.boots.restarts
        return [self._progress(run, now_ms), *self._supersede(run, now_ms)]

    def _progress(self, run: Run, now_ms: int) -> Said:
        run.told_percent, run.told_percent_ms = run.percent, now_ms
        return Said(run.id, Word.IN_PROGRESS, percent=run.percent, late_ms=run.late_ms)

    def _supersede(self, run: Run, now_ms: int) -> list[Output]:
        """End the older commands of the group of a command that is under way, acknowledged or not."""
        out: list[Output] = []
        for other in self.runs.older(run):
            if other.phase is Phase.SENT:
                self.rest(other, now_ms)
            run.modes_before |= other.modes_before | (other.plan.modes or frozenset())
            word, reason = self.pilot.superseded(other)
            by = run.id if word is Word.SUPERSEDED else None
            out.append(self.runs.end(other, word, reason, by=by))
        return out
