"""Cases of the parameter protocol: how an autopilot lists its parameters, takes new values, and refuses others."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from .channel import Heard
from .pilot import Pilot
from .procedures import Procedures, case

SETTINGS: Procedures = {}
LIST_S, ANSWER_S, SECOND_S = 30.0, 3.0, 0.3
REAL32, INT32 = mavlink.MAV_PARAM_TYPE_REAL32, mavlink.MAV_PARAM_TYPE_INT32
HASH = "_HASH_CHECK"


@case(SETTINGS, "parameters read and set")
def _read_and_set(pilot: Pilot) -> None:
    """Requests and answers are recorded as commands; a repeated answer is recorded once."""
    number, whole = pilot.manners.a_float, pilot.manners.a_whole
    before = {name: pilot.parameter(name) or 0.0 for name in (number, whole)}
    _list(pilot)
    _read(pilot, "hash", HASH)
    _read(pilot, "float", number)
    _read(pilot, "unknown", "NOBODY_HAS_IT")
    _read(pilot, "index beyond the last", "", 30_000)
    _set(pilot, "float", number, before[number] + 1, REAL32)
    _set(pilot, "float as a whole number", number, before[number] + 2, INT32)
    _set(pilot, "whole number", whole, before[whole] + 1, INT32)
    _set(pilot, "whole number as a float", whole, before[whole] + 2.4, REAL32)
    _set(pilot, "unknown", "NOBODY_HAS_IT", 1, REAL32)
    _set(pilot, "float back", number, before[number], REAL32)
    _set(pilot, "whole number back", whole, before[whole], INT32)


def _list(pilot: Pilot) -> None:
    heard: list[Any] = []

    def take(one: Heard) -> None:
        if one.kind == "PARAM_VALUE":
            heard.append(one.message)

    def is_whole() -> bool:
        return bool(heard) and {*range(heard[0].param_count)} <= {one.param_index for one in heard}

    pilot.tap(take)
    pilot.send(mavlink.MAVLink_param_request_list_message(pilot.system, 1))
    pilot.until("", is_whole, LIST_S)
    pilot.untap(take)
    pilot.wait(ANSWER_S)  # for repeated values
    pilot.case.acks.append(("list", "a hash first" if heard[0].param_id == HASH else "whole"))


def _read(pilot: Pilot, what: str, name: str, index: int = -1) -> None:
    message = mavlink.MAVLink_param_request_read_message(pilot.system, 1, name.encode(), index)
    _ask(pilot, f"read {what}", message, name)


def _set(pilot: Pilot, what: str, name: str, value: float, kind: int) -> None:
    carried = pilot.manners.carried(value, kind == INT32)
    _ask(pilot, f"set {what}", mavlink.MAVLink_param_set_message(pilot.system, 1, name.encode(), carried, kind), name)


def _ask(pilot: Pilot, what: str, message: Any, name: str) -> None:
    said: list[str] = []

    def take(one: Heard) -> None:
        if one.kind == "PARAM_ERROR":
            said.append(f"error {one.message.error}")
        elif one.kind == "PARAM_VALUE" and one.message.param_id == name:
            value = "a hash" if name == HASH else f"{pilot.manners.parameter_value(one.message):g}"
            said.append(f"{value}{'' if one.message.param_index < one.message.param_count else ' without an index'}")

    pilot.tap(take)
    pilot.send(message)
    end_s = pilot.now_s + ANSWER_S
    while not said and pilot.now_s < end_s:
        pilot.wait(0.02)
    pilot.wait(SECOND_S)
    pilot.untap(take)
    pilot.case.acks.append((what, " then ".join(dict.fromkeys(said)) or None))
