"""MAVLink's parameter protocol towards an autopilot: the whole set read, and one parameter set and read back.

PX4 carries an integer's bytes in the place of the float, ArduPilot the integer converted to a float.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from ...errors import PayloadError
from ...protocol.names import NAME
from ...protocol.parameters import MOST_PARAMETERS, Parameter, ParameterSet, ParameterType, expected
from .mission_protocol import SENDS, ExchangeFailed, Step, Steps
from .plans import AUTOPILOT_COMPONENT, CannotExecute

HASH_CHECK = "_HASH_CHECK"
"""Not a parameter: PX4's hash of all of them."""
QUIET_MS, AGAIN_MS = 1000, 500
"""The silence after which a list counts as ended, and that after which requests are repeated."""
ASKED = 10
"""How many missing parameters are requested at a time."""
SILENT_ASKS = 14
BEGINNINGS = 4
"""How often the reading of a list may begin if its parameters change meanwhile."""
READS, FEW_SENDS = 3, 4
_NAME: Final = re.compile(NAME)
_FORMATS: Final = {"u": "<I", "i": "<i"}
_NOT_THERE: Final = mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST


def parameter_of(message: Any, bytewise: bool) -> Parameter | None:
    """The parameter in a PARAM_VALUE; None if its name, type or value cannot be represented."""
    try:
        if not _NAME.fullmatch(message.param_id):
            return None
        kind = ParameterType(message.param_type)
        value: float = message.param_value
        if bytewise and kind.span is not None:
            (value,) = struct.unpack(_FORMATS[kind.label[0]], _value_bytes(message))
        return Parameter(message.param_id, kind, value)
    except (ValueError, PayloadError):
        return None


def _value_bytes(message: Any) -> bytes:
    """The value's bytes as received: not every 32-bit float survives the conversion to 64 bits and back."""
    frame = message.get_msgbuf()
    start = 10 if frame[0] == mavlink.PROTOCOL_MARKER_V2 else 6
    return bytes(frame[start : start + frame[1]])[:4].ljust(4, b"\0")


def carried(one: Parameter, bytewise: bool) -> float | None:
    """The float for a parameter's value; None for an integer that it cannot carry."""
    if one.value is None:
        return math.nan
    if one.type.span is not None and bytewise:
        data = struct.pack(_FORMATS[one.type.label[0]], one.value)
        (value,) = struct.unpack("<f", data)
        return value if struct.pack("<f", value) == data else None
    (value,) = struct.unpack("<f", struct.pack("<f", one.value))
    return value if value == one.value else None


def set_message(system: int, wanted: Parameter, bytewise: bool) -> Any:
    """PARAM_SET. Raises CannotExecute for an integer that the float cannot carry."""
    value = carried(wanted, bytewise)
    if value is None:
        raise CannotExecute(f"not_carried, {wanted}")
    name = wanted.name.encode()
    return mavlink.MAVLink_param_set_message(system, AUTOPILOT_COMPONENT, name, value, int(wanted.type))


def read_message(system: int, name: str = "", index: int = -1) -> Any:
    """PARAM_REQUEST_READ, by name or by index."""
    return mavlink.MAVLink_param_request_read_message(system, AUTOPILOT_COMPONENT, name.encode(), index)


def is_value_of(name: str) -> Callable[[Any], bool]:
    """Whether a message answers a request for one parameter; PX4 main answers PARAM_ERROR for an unknown one."""
    return lambda message: (
        message.get_type() in ("PARAM_VALUE", "PARAM_ERROR") and str(message.param_id).rstrip("\0") == name
    )


def read(system: int, name: str, bytewise: bool, sends: int = SENDS) -> Steps[Parameter]:
    """Read one parameter. Raises CannotExecute if it is unknown or not carried, ExchangeFailed without an answer."""
    answer = yield Step(read_message(system, name), is_value_of(name), sends=sends)
    found = parameter_of(answer, bytewise) if answer.get_type() == "PARAM_VALUE" else None
    if found is None:
        raise CannotExecute("unknown_parameter" if _is_unknown(answer) else "not_carried")
    return found


def has_hash(system: int, number: int) -> Steps[bool]:
    """Whether PX4 gives `number` as the hash of its parameters."""
    try:
        answer = yield Step(read_message(system, HASH_CHECK), is_value_of(HASH_CHECK), sends=FEW_SENDS)
    except ExchangeFailed:
        return False
    is_told = answer.get_type() == "PARAM_VALUE"
    return is_told and bool(struct.unpack("<I", _value_bytes(answer)) == (number,))


def assign(
    system: int, name: str, value: float, bytewise: bool, span: tuple[float, float] | None = None
) -> Steps[None]:
    """Set a parameter and read it back. Raises CannotExecute before the write, ExchangeFailed after it; CannotExecute
    also if the read-back has no usable value.

    `span` is the documented range, None if it is unknown.
    """
    try:
        before = yield from read(system, name, bytewise, FEW_SENDS)
    except ExchangeFailed as error:
        raise CannotExecute("unknown_parameter") from error
    try:
        wanted = Parameter(name, before.type, value)
    except PayloadError as error:
        raise CannotExecute(f"wrong_value, {expected(before.type)}") from error
    if wanted == before:
        return
    if span is not None and not span[0] <= value <= span[1]:
        raise CannotExecute(f"out_of_range, {span[0]:g} to {span[1]:g}")
    with suppress(ExchangeFailed):  # an autopilot may refuse a value without an answer: the read-back shows it
        yield Step(set_message(system, wanted, bytewise), is_value_of(name), changes=True)
    for _ in range(READS):
        found = yield from read(system, name, bytewise)
        if found == wanted:
            return
    raise ExchangeFailed(f"is {found}")


def _is_unknown(answer: Any) -> bool:
    return bool(answer.get_type() == "PARAM_ERROR" and answer.error == _NOT_THERE)


class SetReading:
    """One reading of an autopilot's whole set: the list, then missing parameters by index, until it is whole.

    Once it `is_over`, either `found` or `error`, the reason, is set. `total` is the autopilot's number of parameters.
    """

    def __init__(self, system: int, bytewise: bool) -> None:
        self.found: ParameterSet | None = None
        self.error: str | None = None
        self._system = system
        self._bytewise = bytewise
        self._indexed: dict[int, Parameter | None] = {}
        self._named: dict[str, Parameter] = {}
        self.total: int | None = None
        self._beginnings = 0
        self._silent_asks = 0
        self._has_asked = False
        self._next_ms = 0

    @property
    def is_over(self) -> bool:
        return self.found is not None or self.error is not None

    def begin(self, now_ms: int) -> list[Any]:
        """Request the list."""
        self._indexed, self._named = {}, {}
        self._has_asked = False
        self._beginnings += 1
        self._next_ms = now_ms + QUIET_MS
        if self._beginnings > BEGINNINGS:
            self.error = "changed_meanwhile"
            return []
        return [mavlink.MAVLink_param_request_list_message(self._system, AUTOPILOT_COMPONENT)]

    def on_value(self, message: Any, now_ms: int) -> list[Any]:
        """Take in a PARAM_VALUE: of the list, of a request by index, or of a parameter that was changed meanwhile."""
        total = message.param_count
        if self.is_over or message.param_id == HASH_CHECK or not total:
            return []
        if total > MOST_PARAMETERS:
            self.error = f"too_many, {total}"
            return []
        if total != self.total:
            was, self.total = self.total, total
            if was is not None:
                return self.begin(now_ms)
        value = parameter_of(message, self._bytewise)
        if message.param_index < total:
            if message.param_index not in self._indexed:
                self._silent_asks = 0
                self._next_ms = now_ms + (AGAIN_MS if self._has_asked else QUIET_MS)
            self._indexed[message.param_index] = value
        elif value is not None:
            self._named[value.name] = value
            if len(self._named) > total:
                return self.begin(now_ms)
        return self._finish(now_ms) if len(self._indexed) == total else []

    def _finish(self, now_ms: int) -> list[Any]:
        """Make the set. If two indexes have one name, indexes have moved and one parameter is missing: begin again."""
        told = [one for one in self._indexed.values() if one is not None]
        known = {one.name: one for one in told}
        if len(known) < len(told):
            return self.begin(now_ms)
        changed = {name: one for name, one in self._named.items() if name in known}
        self.found = ParameterSet.of({**known, **changed}.values())
        return []

    def due(self, now_ms: int) -> list[Any]:
        """The repeated requests, if they are due."""
        if self.is_over or now_ms < self._next_ms:
            return []
        self._next_ms = now_ms + AGAIN_MS
        self._silent_asks += 1
        if self._silent_asks > SILENT_ASKS:
            self.error = "no_answer"
            return []
        if not self.total:
            return [mavlink.MAVLink_param_request_list_message(self._system, AUTOPILOT_COMPONENT)]
        self._has_asked = True
        missing = (index for index in range(self.total) if index not in self._indexed)
        return [read_message(self._system, index=index) for index in islice(missing, ASKED)]
