"""A case of the log protocol: how an autopilot lists its logs, sends bytes of one, and answers while armed."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .channel import Heard
from .pilot import Pilot
from .procedures import Procedures, case

LOGS: Procedures = {}
ANSWER_S, ARMED_S = 2.0, 0.8
"""How long answers are awaited; armed for longer than ARMED_S, PX4 detects a flight."""
WRITTEN_S = 5.0
"""By default an autopilot writes a log while it is armed: for this long, and it has as long to close it."""
ALL, BYTES = 0xFFFF, 90


@case(LOGS, "logs listed and read")
def _listed_and_read(pilot: Pilot) -> None:
    """Requests and answers are recorded as commands; sizes and times are each autopilot's own."""
    _arm(pilot)
    pilot.wait(WRITTEN_S)
    _disarm(pilot)
    pilot.wait(WRITTEN_S)
    _ask(pilot, "bytes before any list", _data(pilot, pilot.manners.first_log, 0, BYTES))
    entries = _ask(pilot, "list", _list(pilot))
    number = entries[0].id
    size = entries[0].size
    last = size // BYTES * BYTES
    _ask(pilot, "ten messages", _data(pilot, number, 0, 10 * BYTES))
    _ask(pilot, "the last bytes", _data(pilot, number, last, BYTES), {size - last: "the rest"})
    _ask(pilot, "some bytes", _data(pilot, number, 45, 100))
    _ask(pilot, "bytes behind the end", _data(pilot, number, size + 100_000_000, BYTES))
    _ask(pilot, "bytes of no log", _data(pilot, 60_000, 0, BYTES))
    pilot.send(mavlink.MAVLink_log_request_end_message(pilot.system, 1))
    _ask(pilot, "bytes behind the end of the transfer", _data(pilot, number, 0, BYTES))
    _ask(pilot, "list again", _list(pilot))
    _arm(pilot)
    _ask(pilot, "list armed", _list(pilot), seconds=ARMED_S)
    _ask(pilot, "bytes armed", _data(pilot, number, 0, BYTES), seconds=ARMED_S)
    _disarm(pilot)
    pilot.send(mavlink.MAVLink_log_request_end_message(pilot.system, 1))


def _arm(pilot: Pilot) -> None:
    pilot.arm()
    pilot.until("armed", lambda: pilot.armed, 10)


def _disarm(pilot: Pilot) -> None:
    pilot.disarm()
    pilot.until("disarmed", lambda: not pilot.armed, 30)


def _list(pilot: Pilot) -> Any:
    return mavlink.MAVLink_log_request_list_message(pilot.system, 1, 0, ALL)


def _data(pilot: Pilot, number: int, offset: int, count: int) -> Any:
    return mavlink.MAVLink_log_request_data_message(pilot.system, 1, number, offset, count)


def _ask(
    pilot: Pilot, what: str, message: Any, named: dict[int, str] | None = None, seconds: float = ANSWER_S
) -> list[Any]:
    """Record the answer: whether the list is whole and its first number, or how long each LOG_DATA is."""
    entries: list[Any] = []
    counts: list[int] = []

    def take(one: Heard) -> None:
        if one.kind == "LOG_ENTRY":
            entries.append(one.message)
        elif one.kind == "LOG_DATA":
            counts.append(one.message.count)

    pilot.tap(take)
    pilot.send(message)
    pilot.wait(seconds)
    pilot.untap(take)
    said = None
    if entries:
        told = {one.id for one in entries}
        said = f"from {min(told)}, {'whole' if len(told) == entries[0].num_logs else 'in part'}"
    elif counts:
        words = [(named or {}).get(count, str(count)) for count in counts]
        said = f"{len(words)} times {words[0]}" if len({*words}) == 1 else ", ".join(words)
    pilot.case.acks.append((what, said))
    return entries
