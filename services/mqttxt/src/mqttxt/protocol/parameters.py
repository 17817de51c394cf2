"""An autopilot's parameters on the wire: a whole set, or the changes since another set (section 17)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

from ..errors import PayloadError
from .codec import encode
from .fields import FLOAT32_MAX, VERSION, Finite, Hash, Items, Name, Named, Version
from .packing import pack, unpack
from .plans import hash_of, single

PARAMETERS = "parameters"
"""The kind of a set of parameters among the objects that are carried in pieces."""
MOST_PARAMETERS = 2000
ParameterName = Annotated[str, Name(16)]


class ParameterType(Named):
    """MAV_PARAM_TYPE, without those that no PARAM_VALUE can carry."""

    UINT8 = 1
    INT8 = 2
    UINT16 = 3
    INT16 = 4
    UINT32 = 5
    INT32 = 6
    REAL32 = 9

    @property
    def span(self) -> range | None:
        """The range of an integer type; None for a float."""
        if self is ParameterType.REAL32:
            return None
        bits = int(self.label.lstrip("uint"))
        least = 0 if self.label.startswith("u") else -(2 ** (bits - 1))
        return range(least, least + 2**bits)


@dataclass(frozen=True)
class Parameter:
    """A parameter by its `name`, its `type` (MAV_PARAM_TYPE) and its value in that type; without a value it is NaN."""

    name: ParameterName
    type: ParameterType
    value: Annotated[float, Finite()] | None = None

    def __post_init__(self) -> None:
        """Round floats to 32 bits. Raises PayloadError for a value that the type does not have."""
        value, span = self.value, self.type.span
        if span is not None and value is not None and value == value // 1 and int(value) in span:
            object.__setattr__(self, "value", int(value))
        elif span is None and (value is None or not abs(value) > FLOAT32_MAX):
            object.__setattr__(self, "value", single(value))
        else:
            raise PayloadError(f"{self.name}: expected {expected(self.type)}, got {value}")

    def __str__(self) -> str:
        """The value, in the form in which it can be set."""
        return "nan" if self.value is None else shortest(self.value)


ParameterItems = Annotated[tuple[Parameter, ...], Items(MOST_PARAMETERS)]


@dataclass(frozen=True, kw_only=True)
class ParametersObject:
    """The set `set` of an autopilot's parameters, whole; or with `base` what is other than in that set.

    `removed` are names that `base` has, and the set does not. The object travels compressed (RFC 1950).
    """

    version: Version = VERSION
    set: Hash
    parameters: ParameterItems
    base: Hash | None = None
    removed: Annotated[tuple[ParameterName, ...], Items(MOST_PARAMETERS)] | None = None


@dataclass(frozen=True, kw_only=True)
class _Listed:
    parameters: ParameterItems


@dataclass(frozen=True)
class ParameterSet:
    """All parameters of an autopilot by their names, in the order of the names."""

    parameters: Mapping[str, Parameter] = field(default_factory=dict)

    @classmethod
    def of(cls, parameters: Iterable[Parameter]) -> ParameterSet:
        """The set of parameters in any order; of two with one name the last counts."""
        by_name = {one.name: one for one in parameters}
        return cls({name: by_name[name] for name in sorted(by_name)})

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters.values())

    def __len__(self) -> int:
        return len(self.parameters)

    def with_one(self, parameter: Parameter) -> ParameterSet:
        """The same set with another value for one parameter."""
        return ParameterSet({**self.parameters, parameter.name: parameter})

    @cached_property
    def hash(self) -> bytes:
        """The name of the set: the hash of its parameters in CBOR. Raises PayloadError for too many parameters."""
        return hash_of(encode(_Listed(parameters=tuple(self))))

    def packed(self, base: ParameterSet | None = None) -> bytes:
        """The bytes of the set, or with `base` those of the changes since it. Raises PayloadError for too many."""
        if base is None:
            return pack(ParametersObject(set=self.hash, parameters=tuple(self)), PARAMETERS)
        changed = tuple(one for one in self if base.parameters.get(one.name) != one)
        removed = tuple(name for name in base.parameters if name not in self.parameters)
        delta = ParametersObject(set=self.hash, parameters=changed, base=base.hash, removed=removed or None)
        return pack(delta, PARAMETERS)

    @classmethod
    def unpacked(cls, data: bytes, base: ParameterSet | None = None) -> ParameterSet:
        """The set from its bytes, or from those of the changes since `base`. Raises PayloadError."""
        found = unpack(ParametersObject, data, PARAMETERS)
        before: dict[str, Parameter] = {}
        if found.base is not None:
            if base is None or base.hash != found.base:
                raise PayloadError(f"{PARAMETERS}: expected changes of a set that is there")
            before = {name: one for name, one in base.parameters.items() if name not in (found.removed or ())}
        made = cls.of([*before.values(), *found.parameters])
        if made.hash != found.set:
            raise PayloadError(f"{PARAMETERS}: expected set {found.set.hex()}, got {made.hash.hex()}")
        return made


def expected(kind: ParameterType) -> str:
    """The allowed values of a type, in words."""
    span = kind.span
    return (
        f"a number of at most {FLOAT32_MAX:.4g} in size"
        if span is None
        else f"a whole number from {span.start} to {span.stop - 1}"
    )


def shortest(value: float) -> str:
    """A 32-bit value in as few digits as identify it."""
    if value == int(value) and abs(value) < 2**53:
        return str(int(value))
    return next(text for text in (f"{value:.{digits}g}" for digits in range(6, 18)) if single(float(text)) == value)
