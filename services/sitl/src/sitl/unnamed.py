"""Messages of MAVLink's common.xml that pymavlink's dialects leave out: their numbers, CRC_EXTRA and layouts."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

_SPECS = {
    "LINK_NODE_STATUS": (8, 117, struct.Struct("<QIIIIIHHHBB")),
    "TIME_ESTIMATE_TO_TARGET": (380, 232, struct.Struct("<iiiii")),
    "CURRENT_EVENT_SEQUENCE": (411, 106, struct.Struct("<HB")),
}
NUMBERS = {name: spec[0] for name, spec in _SPECS.items()}
NAMES = {number: name for name, number in NUMBERS.items()}


@dataclass(frozen=True)
class Unnamed:
    """One such message; its values are in the order of the wire."""

    name: str
    values: tuple[int, ...]

    def get_type(self) -> str:
        """Its name, as pymavlink's messages return theirs."""
        return self.name

    def get_msgId(self) -> int:
        """Its number."""
        return NUMBERS[self.name]

    def pack(self, codec: Any) -> bytes:
        """Make its frame."""
        number, crc_extra, layout = _SPECS[self.name]
        frame = mavlink.MAVLink_message(number, self.name)
        return bytes(frame._pack(codec, crc_extra, layout.pack(*self.values)))
