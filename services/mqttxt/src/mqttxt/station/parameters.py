"""An autopilot's parameters, and the `.params` files that QGroundControl writes of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from ..errors import ConfigurationError, PayloadError
from ..protocol.parameters import Parameter, ParameterSet, ParameterType
from ..security.files import named_by_user, write

AUTOPILOT: Final = 1
"""The MAVLink component id of the autopilot."""
_COLUMNS = "VEHICLE COMPONENT NAME VALUE TYPE, separated by tabs"
_MOST_BYTES = 1_000_000


@dataclass(frozen=True)
class ParameterDifference:
    """A parameter that differs between two sets.

    Parameters:
        name: its name.
        first: its value in the first set; None where it is absent there.
        second: its value in the second set; None where it is absent there.
    """

    name: str
    first: Parameter | None
    second: Parameter | None

    def __str__(self) -> str:
        first, second = ("-" if one is None else str(one) for one in (self.first, self.second))
        return f"{self.name}: {first} and {second}"


@dataclass(frozen=True)
class Parameters:
    """An autopilot's parameters by their names.

        parameters = await drone.parameters()
        parameters["MPC_XY_CRUISE"]

    Parameters:
        content: the parameters with their types, in the order of their names.
    """

    content: ParameterSet

    def __getitem__(self, name: str) -> float:
        """A parameter's value; NaN where the autopilot reports NaN. Raises KeyError for an unknown name."""
        value = self.content.parameters[name].value
        return math.nan if value is None else value

    def __iter__(self) -> Iterator[str]:
        return iter(self.content.parameters)

    def __len__(self) -> int:
        return len(self.content)

    def differences(self, other: Parameters) -> list[ParameterDifference]:
        """The parameters whose value or presence differs in `other`, in the order of their names."""
        mine, theirs = self.content.parameters, other.content.parameters
        names = sorted({*mine, *theirs})
        pairs = (ParameterDifference(name, mine.get(name), theirs.get(name)) for name in names)
        return [one for one in pairs if one.first != one.second]

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a `.params` file of QGroundControl; other components' parameters are left out.

        Parameters:
            path: the file.

        Raises:
            ConfigurationError: the file cannot be read, or is wrong: one line names the file, the line and the field.
        """
        try:
            with Path(path).open("rb") as file:
                data = file.read(_MOST_BYTES + 1)
            text = data.decode()
        except OSError as error:
            raise ConfigurationError(f"{path}: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ConfigurationError(f"{path}: expected parameters in text, got bytes that are no UTF-8") from error
        if len(data) > _MOST_BYTES:
            raise ConfigurationError(f"{path}: expected at most {_MOST_BYTES} bytes")
        found: dict[str, Parameter] = {}
        for number, line in enumerate(text.splitlines(), start=1):
            try:
                one = _parsed(line)
                if one is not None and one.name in found:
                    raise PayloadError(f"{one.name}: expected each parameter once")
            except (ValueError, PayloadError) as error:
                raise ConfigurationError(f"{path}: line {number}: {error}") from error
            if one is not None:
                found[one.name] = one
        if not found:
            raise ConfigurationError(f"{path}: no parameters; expected lines of {_COLUMNS}")
        return cls(ParameterSet.of(found.values()))

    def save(self, path: Path | str, drone: int = 1) -> None:
        """Write a `.params` file that QGroundControl opens; an existing file is replaced, behind symbolic links.

        Parameters:
            path: the file.
            drone: the drone's number, which the file names.

        Raises:
            ConfigurationError: the file cannot be written, or is no regular one; an existing one is unchanged.
        """
        lines = [f"# Onboard parameters for Vehicle {drone}", "#", "# Vehicle-Id Component-Id Name Value Type"]
        lines += [f"{drone}\t{AUTOPILOT}\t{one.name}\t{one}\t{int(one.type)}" for one in self.content]
        write(named_by_user(Path(path)), ("\n".join(lines) + "\n").encode())


def _parsed(line: str) -> Parameter | None:
    """The parameter of a line; None for a comment, an empty line and another component's. Raises ValueError."""
    if not line.strip() or line.lstrip().startswith("#"):
        return None
    columns = line.split()
    if len(columns) != 5:
        raise ValueError(f"expected {_COLUMNS}, got {line.strip()[:60]!r}")
    _, component, name, value, kind = columns
    if _whole("component", component) != AUTOPILOT:
        return None
    number = _whole("type", kind)
    if number not in list(ParameterType):
        raise ValueError(f"{name}: type {kind}: expected one of {', '.join(str(int(one)) for one in ParameterType)}")
    return checked(name, value, ParameterType(number))


def checked(name: str, value: str, kind: ParameterType) -> Parameter:
    """A parameter from a value in text. Raises ValueError if it is no number, PayloadError if of another type.

    Python also reads `1_5`, as 15, and digits of other scripts, which no file of QGroundControl has.
    """
    if not 0 < len(name) <= 16:
        raise ValueError(f"{name}: expected a name of 1 to 16 characters")
    try:
        number = float(value if value.isascii() and "_" not in value else "")
    except ValueError:
        raise ValueError(f"{name}: expected a number, got {value[:40]!r}") from None
    return Parameter(name, kind, None if math.isnan(number) else number)


def _whole(what: str, text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= 3):
        raise ValueError(f"{what}: expected a whole number, got {text[:40]!r}")
    return int(text)
