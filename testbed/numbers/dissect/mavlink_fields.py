"""scapy fields for MAVLink's messages: little-endian, with the value names and units of common.xml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scapy.fields import Field
from scapy.packet import Packet

FORMATS = {
    "int8_t": "b",
    "uint8_t": "B",
    "int16_t": "h",
    "uint16_t": "H",
    "int32_t": "i",
    "uint32_t": "I",
    "int64_t": "q",
    "uint64_t": "Q",
    "float": "f",
    "double": "d",
}
"""struct's letter for each type of common.xml except char."""


class Number(Field[Any, Any]):
    """One number. `names` are those of its enumeration's values, or with `bits` of its bits; it accepts names too."""

    __slots__ = ["bits", "names", "unit"]

    def __init__(
        self, name: str, kind: str, names: Mapping[int, str] | None = None, unit: str = "", bits: bool = False
    ) -> None:
        self.names, self.unit, self.bits = names or {}, unit, bits
        super().__init__(name, 0, f"<{FORMATS[kind]}")

    def any2i(self, pkt: Packet | None, x: Any) -> Any:
        if isinstance(x, str):
            found = [number for number, name in self.names.items() if name == x]
            if not found:
                raise ValueError(f"{self.name}: {x!r}: expected a number or one of {', '.join(self.names.values())}")
            return found[0]
        return x

    def i2repr(self, pkt: Packet | None, x: Any) -> str:
        if isinstance(x, float):
            return f"{x:.9g} {self.unit}".rstrip()
        if self.bits and isinstance(x, int):
            named = "+".join(name for bit, name in self.names.items() if bit and x & bit == bit)
            return f"{x:#x} ({named})" if named else f"{x:#x}"
        name = self.names.get(x)
        return f"{x} ({name})" if name is not None else f"{x} {self.unit}".rstrip()


class NumberArray(Field[Any, Any]):
    """An array of numbers, of the length in common.xml; missing ones are 0."""

    __slots__ = ["count", "unit"]
    islist = 1
    ismutable = True

    def __init__(self, name: str, kind: str, count: int, unit: str = "") -> None:
        self.count, self.unit = count, unit
        super().__init__(name, [], f"<{count}{FORMATS[kind]}")
        self.default = [0] * count

    def any2i(self, pkt: Packet | None, x: Any) -> Any:
        if isinstance(x, Sequence | bytearray):
            if len(x) > self.count:
                raise ValueError(f"{self.name}: expected at most {self.count} values, got {len(x)}")
            return [*x, *[0] * (self.count - len(x))]
        return x

    def getfield(self, pkt: Packet, s: bytes) -> tuple[bytes, Any]:
        return s[self.sz :], list(self.struct.unpack_from(s))

    def addfield(self, pkt: Packet, s: bytes, val: Any) -> bytes:
        return s + self.struct.pack(*(val if val is not None else [0] * self.count))

    def i2repr(self, pkt: Packet | None, x: Any) -> str:
        inner = ", ".join(f"{value:.9g}" if isinstance(value, float) else str(value) for value in x)
        return f"[{inner}] {self.unit}".rstrip()


class CharArray(Field[Any, Any]):
    """A char array: bytes of its full length, shown up to the first zero byte."""

    __slots__: list[str] = []

    def __init__(self, name: str, length: int) -> None:
        super().__init__(name, None, f"<{length}s")
        self.default = bytes(length)

    def any2i(self, pkt: Packet | None, x: Any) -> Any:
        given = x.encode() if isinstance(x, str) else x
        if isinstance(given, bytes) and len(given) > self.sz:
            raise ValueError(f"{self.name}: expected at most {self.sz} bytes, got {len(given)}")
        return given.ljust(self.sz, b"\0") if isinstance(given, bytes) else given

    def i2repr(self, pkt: Packet | None, x: Any) -> str:
        return repr(x.split(b"\0")[0].decode(errors="backslashreplace"))
