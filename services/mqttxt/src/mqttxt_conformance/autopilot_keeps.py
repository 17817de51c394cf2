"""What the kit's autopilot keeps: its parameters, which it tells and sets as a PX4 does, and its flight logs."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

INT32, REAL32 = 6, 9
DATA_BYTES = 90
"""In one LOG_DATA."""


def as_float(kind: int, value: float) -> float:
    """A parameter's value as PX4 carries it: the bytes of a whole number in the float's place."""
    return float(struct.unpack("<f", struct.pack("<i", int(value)))[0]) if kind == INT32 else value


def as_value(kind: int, carried: float) -> float:
    """The value that such a float carries."""
    return int(struct.unpack("<i", struct.pack("<f", carried))[0]) if kind == INT32 else carried


@dataclass
class Parameters:
    """The parameters by name, each with its MAV_PARAM_TYPE; while `takes_none`, PARAM_SET is not answered."""

    values: dict[str, tuple[int, float]]
    takes_none: bool = False

    def told(self, name: str) -> Any:
        """PARAM_VALUE of a parameter."""
        kind, value = self.values[name]
        carried, index = as_float(kind, value), sorted(self.values).index(name)
        return mavlink.MAVLink_param_value_message(name.encode(), carried, kind, len(self.values), index)

    def answers(self, message: Any) -> list[Any]:
        """What it sends when a message was written to it."""
        names = sorted(self.values)
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                return [self.told(name) for name in names]
            case "PARAM_REQUEST_READ" if message.param_index >= 0:
                return [self.told(name) for name in names[message.param_index :][:1]]
            case "PARAM_REQUEST_READ" if message.param_id in self.values:
                return [self.told(message.param_id)]
            case "PARAM_SET" if message.param_id in self.values and not self.takes_none:
                kind = self.values[message.param_id][0]
                self.values[message.param_id] = kind, as_value(kind, message.param_value)
                return [self.told(message.param_id)]
        return []


@dataclass
class Logs:
    """The flight logs by number, each with its time (s since 1970) and its bytes."""

    logs: dict[int, tuple[int, bytes]] = field(default_factory=dict)

    def answers(self, message: Any) -> list[Any]:
        """What it sends when a message was written to it."""
        match message.get_type():
            case "LOG_REQUEST_LIST":
                total, last = len(self.logs), max(self.logs, default=0)
                return [
                    mavlink.MAVLink_log_entry_message(number, total, last, time_s, len(data))
                    for number, (time_s, data) in sorted(self.logs.items())
                ]
            case "LOG_REQUEST_DATA" if message.id in self.logs:
                data = self.logs[message.id][1][: message.ofs + message.count]
                offsets = range(message.ofs, len(data), DATA_BYTES)
                return [_log_data(message.id, offset, data[offset : offset + DATA_BYTES]) for offset in offsets]
        return []


def _log_data(number: int, offset: int, data: bytes) -> Any:
    return mavlink.MAVLink_log_data_message(number, offset, len(data), list(data.ljust(DATA_BYTES, b"\0")))
