"""MAVLink's mission protocol towards an autopilot, in steps: a message to write, and its possible answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

from pymavlink.dialects.v20 import common as mavlink

from ...protocol.plans import MOST_ITEMS, PlanItem, PlanList
from .plans import AUTOPILOT_COMPONENT, NAN, CannotExecute

AGAIN_MS = 500
SENDS = 14
"""Writes go on for longer than an autopilot takes to give up another station's broken transfer: PX4 needs 5 s."""
FENCE_CORNERS = (
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
"""Items of a fence whose first parameter is the number of corners of their polygon."""
FENCE_CIRCLES = (mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)
"""Items of a fence whose first parameter is a radius, in metres."""
INT_FRAMES: Final[dict[int, int]] = {
    mavlink.MAV_FRAME_GLOBAL: mavlink.MAV_FRAME_GLOBAL_INT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT: mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT: mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
}
"""The frames of MISSION_ITEM_INT, by which MAVSDK recognises a height above home; the plan has the others."""
_PLAIN_FRAMES: Final = {one: other for other, one in INT_FRAMES.items()}
_BUSY = (mavlink.MAV_MISSION_ERROR, mavlink.MAV_MISSION_DENIED)
Result = TypeVar("Result")


class ExchangeFailed(Exception):
    """A list was not written or read; the text is part of the outcome's reason."""


@dataclass(frozen=True)
class Step:
    """A message to write until an answer arrives; with `answers` None no answer is awaited.

    `changes`: the write may change the list. `sends`: how often it is written at most.
    """

    message: Any
    answers: Callable[[Any], bool] | None = None
    changes: bool = False
    sends: int = SENDS


Steps = Generator[Step, Any, Result]
"""Steps of a transfer: each is sent its answer, or thrown ExchangeFailed if none arrived."""


class Exchange:
    """Carries out the steps of one transfer with an autopilot. `result` is set once it `is_over` without `error`."""

    def __init__(self, steps: Steps[Any]) -> None:
        self._steps = steps
        self._step: Step | None = None
        self._sends = 0
        self._sent_ms = 0
        self.result: Any = None
        self.error: ExchangeFailed | CannotExecute | None = None
        self.has_begun = False
        self.is_over = False

    def begin(self, now_ms: int) -> list[Step]:
        """The first writes."""
        self.has_begun = True
        return self._go_on(None, now_ms)

    def on_message(self, message: Any, now_ms: int) -> list[Step]:
        """The writes that follow from a message of the autopilot."""
        step = self._step
        if step is None or step.answers is None or not step.answers(message):
            return []
        return self._go_on(message, now_ms)

    def tick(self, now_ms: int) -> list[Step]:
        """Repeat the unanswered write; after the last one, throw ExchangeFailed into the steps."""
        step = self._step
        if step is None or now_ms < self._sent_ms + AGAIN_MS:
            return []
        if self._sends >= step.sends:
            return self._go_on(ExchangeFailed("no_answer"), now_ms)
        self._sends, self._sent_ms = self._sends + 1, now_ms
        return [step]

    def stop(self) -> None:
        """Give the transfer up."""
        self._step, self.is_over = None, True
        self._steps.close()

    def _go_on(self, answer: Any, now_ms: int) -> list[Step]:
        """Go on to the next step that waits for an answer, or to the end."""
        out: list[Step] = []
        self._step = None
        try:
            failed = isinstance(answer, ExchangeFailed)
            step = self._steps.throw(answer) if failed else self._steps.send(answer)
            while step.answers is None:
                out.append(step)
                step = next(self._steps)
            self._step, self._sends, self._sent_ms = step, 1, now_ms
            out.append(step)
        except StopIteration as end:
            self.result, self.is_over = end.value, True
        except (ExchangeFailed, CannotExecute) as error:
            self.error, self.is_over = error, True
        return out


def read(system: int, kind: PlanList, before: int = 0) -> Steps[tuple[PlanItem, ...]]:
    """Read a list. Raises ExchangeFailed, also for a list that a plan cannot have.

    `before`: how many of the items precede those of the plan.
    """
    target = (system, AUTOPILOT_COMPONENT)
    is_count = _is_one("MISSION_COUNT", kind)
    told = yield Step(mavlink.MAVLink_mission_request_list_message(*target, kind), is_count)
    if told.count > MOST_ITEMS + before:
        raise ExchangeFailed(f"{kind.label}: expected at most {MOST_ITEMS} items, got {told.count}")
    items = []
    for seq in range(told.count):

        def is_item(message: Any, seq: int = seq) -> bool:
            kinds = ("MISSION_ITEM_INT", "MISSION_ACK")
            right = message.get_type() in kinds and message.mission_type == kind
            return right and (message.get_type() == "MISSION_ACK" or message.seq == seq)

        found = yield Step(mavlink.MAVLink_mission_request_int_message(*target, seq, kind), is_item)
        if found.get_type() == "MISSION_ACK":
            raise ExchangeFailed(f"{kind.label} item {seq + 1}: {result_name(found.type)}")
        item = item_of(found)
        if any(math.isinf(value) for value in (*item.params, item.z) if value is not None):
            raise ExchangeFailed(f"{kind.label} item {seq + 1}: expected finite values")
        items.append(item)
    yield Step(mavlink.MAVLink_mission_ack_message(*target, mavlink.MAV_MISSION_ACCEPTED, kind))
    return tuple(items)


def write(system: int, kind: PlanList, items: tuple[PlanItem, ...], before: int = 0) -> Steps[None]:
    """Replace a list. Raises ExchangeFailed, with the item that the autopilot refused.

    `before`: how many of the items precede those of the plan.
    """
    target = (system, AUTOPILOT_COMPONENT)
    if not items:
        cleared = yield Step(
            mavlink.MAVLink_mission_clear_all_message(*target, kind), _is_one("MISSION_ACK", kind), changes=True
        )
        _check(cleared, kind.label)
        return
    count = Step(mavlink.MAVLink_mission_count_message(*target, len(items), kind), _asks_or_ends(kind), changes=True)
    answer, what = (yield count), kind.label
    if answer.get_type() == "MISSION_ACK" and answer.type in _BUSY:  # with the client's own broken upload
        yield Step(mavlink.MAVLink_mission_ack_message(*target, mavlink.MAV_MISSION_OPERATION_CANCELLED, kind))
        answer = yield count
    while answer.get_type() != "MISSION_ACK":
        seq = answer.seq
        if seq >= len(items):
            raise ExchangeFailed(f"{kind.label}: asked for item {seq + 1} of {len(items)}")
        what = f"{kind.label} item {seq + 1 - before}"
        answer = yield Step(message_of(items[seq], target, seq, kind), _asks_or_ends(kind))
    _check(answer, what)


def set_current(system: int, seq: int) -> Steps[None]:
    """Make an item the current one, until MISSION_CURRENT shows it."""

    def is_current(message: Any) -> bool:
        return bool(message.get_type() == "MISSION_CURRENT" and message.seq == seq)

    yield Step(mavlink.MAVLink_mission_set_current_message(system, AUTOPILOT_COMPONENT, seq), is_current, changes=True)


def item_of(message: Any) -> PlanItem:
    """The item in a MISSION_ITEM_INT."""
    params = (message.param1, message.param2, message.param3, message.param4)
    return PlanItem(message.frame, message.command, params, message.x, message.y, message.z, bool(message.autocontinue))


def message_of(item: PlanItem, target: tuple[int, int], seq: int, kind: PlanList) -> Any:
    """The item as MISSION_ITEM_INT."""
    system, component = target
    param1, param2, param3, param4 = [NAN if param is None else param for param in item.params]
    return mavlink.MAVLink_mission_item_int_message(
        target_system=system,
        target_component=component,
        seq=seq,
        frame=item.frame,
        command=item.command,
        current=int(kind is PlanList.MISSION and seq == 0),
        autocontinue=int(item.autocontinue),
        param1=param1,
        param2=param2,
        param3=param3,
        param4=param4,
        x=item.x,
        y=item.y,
        z=NAN if item.z is None else item.z,
        mission_type=kind,
    )


def plain_frame(frame: int) -> int:
    """The plan's frame for one of MISSION_ITEM_INT."""
    return _PLAIN_FRAMES.get(frame, frame)


def jumping(item: PlanItem, by: int) -> PlanItem:
    """A DO_JUMP with its target moved by `by` items; any other item unchanged."""
    if item.command != mavlink.MAV_CMD_DO_JUMP or item.params[0] is None:
        return item
    return replace(item, params=(item.params[0] + by, *item.params[1:]))


def result_name(result: int) -> str:
    """A MAV_MISSION_RESULT in words."""
    entry = mavlink.enums["MAV_MISSION_RESULT"].get(result)
    return f"mav_mission_result_{result}" if entry is None else entry.name.removeprefix("MAV_MISSION_").lower()


def _is_one(name: str, kind: PlanList) -> Callable[[Any], bool]:
    return lambda message: bool(message.get_type() == name and message.mission_type == kind)


def _asks_or_ends(kind: PlanList) -> Callable[[Any], bool]:
    """Whether a message requests an item or ends the upload; the refusal of a duplicate item does neither."""

    def answers(message: Any) -> bool:
        name = message.get_type()
        if name not in ("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK") or message.mission_type != kind:
            return False
        return bool(name != "MISSION_ACK" or message.type != mavlink.MAV_MISSION_INVALID_SEQUENCE)

    return answers


def _check(answer: Any, what: str) -> None:
    if answer.type != mavlink.MAV_MISSION_ACCEPTED:
        raise ExchangeFailed(f"{what}: {result_name(answer.type)}")
