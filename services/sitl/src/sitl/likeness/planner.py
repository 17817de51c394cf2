"""Speaks MAVLink's mission protocol with an autopilot, and records each answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from ..plans import FENCE, MISSION, RALLY, Item
from .channel import Heard
from .observer import Timeout
from .pilot import Pilot

ANSWER_S = 1.5
RESULTS = {
    n: entry.name.removeprefix("MAV_MISSION_").lower() for n, entry in mavlink.enums["MAV_MISSION_RESULT"].items()
}
_LISTS = {MISSION: "", FENCE: "fence ", RALLY: "rally "}
SILENT_S = 1.5
"""An upload is abandoned once no item was requested for this time."""
_REQUESTS = ("MISSION_REQUEST", "MISSION_REQUEST_INT")
_ANSWERS = ("MISSION_ACK", "MISSION_COUNT", "MISSION_ITEM_INT", *_REQUESTS)


class Planner:
    """One side of the protocol, over a pilot's link. Requests and answers are recorded in its case as commands."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._to = (pilot.system, 1)
        self.current = 0
        self.reached = -1

    def follow(self) -> None:
        """Record from now on which item is current, and which was reached."""
        self.current, self.reached = 0, -1
        if self._pilot.manners.asks:
            self._pilot.ask_for("MISSION_CURRENT", 1.0)
        self._pilot.tap(self._follow)

    def unfollow(self) -> None:
        if self._pilot.manners.asks:
            self._pilot.unask("MISSION_CURRENT")
        self._pilot.untap(self._follow)

    def _follow(self, heard: Heard) -> None:
        for kind, name in (("MISSION_CURRENT", "current"), ("MISSION_ITEM_REACHED", "reached")):
            if heard.kind == kind and heard.message.seq != getattr(self, name):
                setattr(self, name, heard.message.seq)
                self._pilot.case.events.append((round(self._pilot.now_s, 2), name, str(heard.message.seq)))

    def abandon(self, kind: int = MISSION) -> None:
        """Cancel an upload, and wait until no item is requested any more; some autopilots ignore the cancellation."""
        self.send(mavlink.MAVLink_mission_ack_message(*self._to, mavlink.MAV_MISSION_OPERATION_CANCELLED, kind))
        while any(heard.kind in _REQUESTS for heard in self._pilot.collect(SILENT_S)):
            pass

    def send(self, message: Any) -> None:
        self._pilot.send(message)

    def ask(self, name: str, message: Any) -> Any:
        """Send a message; record and return the first answer, None without one."""
        answers: list[Any] = []

        def take(heard: Heard) -> None:
            if heard.kind in _ANSWERS:
                answers.append(heard.message)

        pilot = self._pilot
        pilot.tap(take)
        self.send(message)
        end_s = pilot.now_s + ANSWER_S
        while not answers and pilot.now_s < end_s:
            pilot.wait(0.02)
        pilot.untap(take)
        answer = answers[0] if answers else None
        pilot.case.acks.append((name, _said(answer)))
        return answer

    def count(self, items: int, kind: int = MISSION) -> Any:
        return self.ask(f"count {items}", mavlink.MAVLink_mission_count_message(*self._to, items, kind))

    def item(self, item: Item, seq: int, kind: int = MISSION) -> Any:
        return self.ask(f"item {seq}", item.message(self._to, seq, kind, seq == 0))

    def upload(self, items: Sequence[Item], kind: int = MISSION) -> None:
        """Upload a list correctly. Raises Timeout if it is not accepted."""
        answer = self.count(len(items), kind)
        for seq, item in enumerate(items):
            answer = self.item(item, seq, kind)
        if answer is None or answer.get_type() != "MISSION_ACK" or answer.type != mavlink.MAV_MISSION_ACCEPTED:
            raise Timeout(f"upload of {len(items)} items: {self._pilot.case.acks[-1]}")

    def list(self, kind: int = MISSION) -> int:
        """Request a list, and return its number of items."""
        answer = self.ask("list", mavlink.MAVLink_mission_request_list_message(*self._to, kind))
        return int(answer.count) if answer is not None and answer.get_type() == "MISSION_COUNT" else 0

    def want(self, seq: int, kind: int = MISSION) -> Any:
        return self.ask(f"want {seq}", mavlink.MAVLink_mission_request_int_message(*self._to, seq, kind))

    def end(self, kind: int = MISSION) -> None:
        """Acknowledge a finished download."""
        self.send(mavlink.MAVLink_mission_ack_message(*self._to, mavlink.MAV_MISSION_ACCEPTED, kind))
        self._pilot.wait(0.2)

    def download(self, sent: Sequence[Item], kind: int = MISSION) -> None:
        """Read a list back, and record the fields of its items that differ from those sent."""
        for seq in range(self.list(kind)):
            found = self.want(seq, kind)
            if found is None or found.get_type() != "MISSION_ITEM_INT":
                break
            for field, was, now in _differences(sent[seq], Item.of(found)):
                self._pilot.case.numbers[f"{_LISTS[kind]}item {seq}, {field} from {was:g}"] = now
        self.end(kind)

    def clear(self, kind: int = MISSION) -> None:
        self.ask("clear", mavlink.MAVLink_mission_clear_all_message(*self._to, kind))

    def set_current(self, seq: int) -> None:
        self.send(mavlink.MAVLink_mission_set_current_message(*self._to, seq))


def _said(answer: Any) -> str | None:
    """An answer in words: its kind, and the item or the result."""
    if answer is None:
        return None
    kind = answer.get_type()
    if kind == "MISSION_ACK":
        return f"ack {RESULTS.get(answer.type, str(answer.type))}"
    if kind == "MISSION_COUNT":
        return f"count {answer.count}"
    return f"{kind.removeprefix('MISSION_').lower().replace('_', ' ')} {answer.seq}"


def _differences(sent: Item, found: Item) -> list[tuple[str, float, float]]:
    """The fields that came back changed; -1 stands for NaN and infinities."""
    fields: list[tuple[str, float, float]] = [
        ("frame", sent.frame, found.frame),
        ("command", sent.command, found.command),
    ]
    fields += [(f"param{n}", was, now) for n, (was, now) in enumerate(zip(sent.params, found.params, strict=True), 1)]
    fields += [("x", sent.x, found.x), ("y", sent.y, found.y), ("z", sent.z, found.z)]
    fields += [("autocontinue", sent.autocontinue, found.autocontinue)]
    numbers = [(name, _number(was), _number(now)) for name, was, now in fields]
    return [one for one in numbers if not math.isclose(one[1], one[2], rel_tol=1e-6)]


def _number(value: float) -> float:
    return round(value, 4) if math.isfinite(value) else -1.0
