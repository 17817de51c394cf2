"""Commands as people type them: a name, and its parameters in order."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from ..core.clock import MAX_TTL_MS
from ..errors import ConfigurationError
from ..protocol.codec import layout_of
from ..protocol.commands import COMMANDS, Attitude, Command, Mavlink, Offboard, Takeoff, Velocity
from ..protocol.fields import FLOAT32_MAX, Binary, Finite, Integer, Name, Scaled, Text
from ..protocol.messages import Limit
from ..protocol.values import mark_of

_NOT_SET = ("-", "nan")
_OPTION = re.compile("--[a-zA-Z]")
_LIMIT: Scaled = mark_of(Limit)
_MAV_CMD = Integer(0, 2**16 - 1)


def parse_command(name: str, parameters: list[str]) -> Command:
    """A command from its name and its parameters; raises ConfigurationError."""
    cls: type[Any] | None = COMMANDS.get(name)
    if cls is None:
        raise ConfigurationError(f"command {name!r}: expected one of {', '.join(COMMANDS)}")
    if cls is Takeoff and not parameters:
        return Takeoff()
    special: dict[type[Any], Callable[[list[str]], Command]] = {Offboard: _offboard, Mavlink: _mavlink}
    found: Command = special[cls](parameters) if cls in special else _fields(name, cls, parameters)
    return found


def refuse_options(typed: list[str]) -> None:
    """Raises ConfigurationError for a word that looks like an option: existing options were taken out before."""
    for word in typed:
        if _OPTION.match(word):
            raise ConfigurationError(f"gs send: no such option: {word.partition('=')[0]}")


def check_times(ttl_s: float, limit_s: float | None = None) -> None:
    """Raises ConfigurationError for an invalid `--ttl` or `--limit`."""
    most_s = MAX_TTL_MS // 1000
    if not 0 < ttl_s <= most_s:
        raise ConfigurationError(f"--ttl {ttl_s:g}: expected more than 0 and at most {most_s} s")
    if limit_s is not None and not _LIMIT.low <= limit_s <= _LIMIT.high:
        raise ConfigurationError(f"--limit {limit_s:g}: expected {_LIMIT.low:g} to {_LIMIT.high:.0f} s")


def _offboard(parameters: list[str]) -> Offboard:
    kinds: dict[str, type[Any]] = {"velocity": Velocity, "attitude": Attitude}
    if len(parameters) < 2 or parameters[1] not in kinds:
        raise _unexpected("offboard", "SECONDS, then velocity or attitude", parameters)
    seconds = _value("offboard", "duration_s", layout_of(Offboard).fields[0].mark, parameters[0])
    kind = parameters[1]
    return Offboard(seconds, **{kind: _fields(f"offboard {kind}", kinds[kind], parameters[2:])})


def _mavlink(parameters: list[str]) -> Mavlink:
    if not 1 <= len(parameters) <= 8:
        raise _unexpected("mavlink", "MAV_CMD and up to seven parameters", parameters)
    from ..drone.mavlink.raw import MAV_CMDS

    numbers = {name: number for number, name in MAV_CMDS.items()}
    number = numbers.get("MAV_CMD_" + parameters[0].upper().removeprefix("MAV_CMD_"))
    if number is None and not parameters[0].isidentifier():
        number = _value("mavlink", "mav_cmd", _MAV_CMD, parameters[0])
    elif number is None:
        raise ConfigurationError(f"mavlink mav_cmd {parameters[0]!r}: expected a MAV_CMD's name or number")
    wide = Scaled(1, -FLOAT32_MAX, FLOAT32_MAX)
    params = [
        None if text.lower() in _NOT_SET else _value("mavlink", f"param{index}", wide, text)
        for index, text in enumerate(parameters[1:], start=1)
    ]
    return Mavlink(number, (*params, *[None] * (7 - len(params))))


def _fields(name: str, cls: type[Any], parameters: list[str]) -> Any:
    """A dataclass of numbers and texts; optional fields may be left out at the end."""
    fields = layout_of(cls).fields
    least = len([field for field in fields if not field.optional])
    if not least <= len(parameters) <= len(fields):
        names = [f"[{field.name.upper()}]" if field.optional else field.name.upper() for field in fields]
        raise _unexpected(name, " ".join(names) or "no parameters", parameters)
    given = zip(fields, parameters, strict=False)
    return cls(**{field.name: _value(name, field.name, field.mark, text) for field, text in given})


def _value(name: str, field: str, mark: Any, text: str) -> Any:
    if isinstance(mark, Text):
        if not 0 < len(text) <= mark.longest:
            raise ConfigurationError(f"{name} {field} {text!r}: expected 1 to {mark.longest} characters")
        if isinstance(mark, Name) and not re.fullmatch(mark.pattern, text):
            raise ConfigurationError(f"{name} {field} {text!r}: expected ASCII letters, digits, _, . and -")
        return text
    if isinstance(mark, Binary):
        if not re.fullmatch(rf"([0-9a-fA-F]{{2}}){{{mark.least},{mark.most}}}", text):
            raise ConfigurationError(f"{name} {field} {text!r}: expected {mark.least} bytes in hexadecimal")
        return bytes.fromhex(text)
    value = _decimal(text)
    if isinstance(mark, Finite):
        if not math.isfinite(value):
            raise ConfigurationError(f"{name} {field} {text!r}: expected a finite number")
        return value
    if not mark.low <= value <= mark.high or (isinstance(mark, Integer) and value != int(value)):
        kind = "a whole number" if isinstance(mark, Integer) else "a number"
        raise ConfigurationError(f"{name} {field} {text!r}: expected {kind} from {mark.low:g} to {mark.high:g}")
    return int(value) if isinstance(mark, Integer) else value


def _decimal(text: str) -> float:
    """The number in a text, NaN if there is none. `1_5` is 15 for Python, which no user means."""
    try:
        return float(text) if text.isascii() and "_" not in text else float("nan")
    except ValueError:
        return float("nan")


def _unexpected(name: str, expected: str, parameters: list[str]) -> ConfigurationError:
    return ConfigurationError(f"{name}: expected {expected}, got {' '.join(parameters) or 'nothing'}")
