"""The rights of a ground station, which its certificate has as URIs of the subject's alternative names.

`mqttxt:may/command/1-3,7` (or `*`), `mqttxt:may/upload-plan`, `mqttxt:may/set-parameters`,
`mqttxt:may/take-over`, `mqttxt:may/observe`. Every certificate also has the fleet, `mqttxt:fleet/NAME`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

from ..errors import ConfigurationError
from ..protocol.commands import Command, Mavlink, PlanCommand, SetParameter
from ..protocol.names import MAX_DRONE

SCHEME = "mqttxt:"
FLEET = SCHEME + "fleet/"
COMMAND = SCHEME + "may/command/"
TAKE_OVER = SCHEME + "may/take-over"
UPLOAD_PLAN = SCHEME + "may/upload-plan"
SET_PARAMETERS = SCHEME + "may/set-parameters"
OBSERVE = SCHEME + "may/observe"
_PLAIN = (UPLOAD_PLAN, SET_PARAMETERS, TAKE_OVER, OBSERVE)
EVERY = "*"
DO_SET_PARAMETER, PREFLIGHT_STORAGE = 180, 245
"""MAV_CMDs that set parameters too, or reset all of them."""


def parse_numbers(text: str, most: int, what: str) -> frozenset[int]:
    """Parse whole numbers from 1 to `most`, as `1-3,7`; raises ConfigurationError prefixed with `what`."""
    numbers: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        ends = [first, last if dash else first]
        if not all(end.isascii() and end.isdecimal() and len(end) <= len(str(most)) for end in ends):
            raise _not_numbers(text, most, what)
        low, high = (int(end) for end in ends)
        if not 1 <= low <= high <= most:
            raise _not_numbers(text, most, what)
        numbers.update(range(low, high + 1))
    return frozenset(numbers)


def write_numbers(numbers: Iterable[int]) -> str:
    """Numbers in their shortest form, as `1-3,7`."""
    ordered = sorted(numbers)
    starts = [number for before, number in pairwise([-1, *ordered]) if number != before + 1]
    ends = [number for number, behind in pairwise([*ordered, -1]) if behind != number + 1]
    return ",".join(f"{start}-{end}" if start != end else f"{start}" for start, end in zip(starts, ends, strict=True))


def command_right(drone: int) -> str:
    """The right that a station needs to command a drone."""
    return f"{COMMAND}{drone}"


@dataclass(frozen=True)
class Rights:
    """The rights of a station. `command` has the drones that it may command; None: every drone of the fleet.

    `upload_plan`: it may also replace and clear their plans; `set_parameters`: it may set their parameters.
    """

    command: frozenset[int] | None = frozenset()
    take_over: bool = False
    observe: bool = False
    upload_plan: bool = False
    set_parameters: bool = False

    def may_command(self, drone: int) -> bool:
        return self.command is None or drone in self.command

    @property
    def may_hear(self) -> bool:
        """Whether the station may receive states, words and readings: any right is enough."""
        return self != Rights()

    def missing(self, command: Command, drone: int) -> str | None:
        """The missing right for a command to a drone; None if none is missing."""
        if not self.may_command(drone):
            return command_right(drone)
        if isinstance(command, PlanCommand) and not self.upload_plan:
            return UPLOAD_PLAN
        sets_parameters = isinstance(command, SetParameter) or (
            isinstance(command, Mavlink) and command.mav_cmd in (DO_SET_PARAMETER, PREFLIGHT_STORAGE)
        )
        return SET_PARAMETERS if sets_parameters and not self.set_parameters else None

    def uris(self) -> tuple[str, ...]:
        """The rights as URIs of a certificate."""
        command = EVERY if self.command is None else write_numbers(self.command)
        given = (
            (COMMAND + command, command != ""),
            (UPLOAD_PLAN, self.upload_plan),
            (SET_PARAMETERS, self.set_parameters),
            (TAKE_OVER, self.take_over),
            (OBSERVE, self.observe),
        )
        return tuple(uri for uri, has in given if has)

    @classmethod
    def of_uris(cls, uris: Iterable[str]) -> Rights:
        """Parse a certificate's URIs; raises ConfigurationError for one that is unknown or repeated."""
        command: frozenset[int] | None = frozenset()
        seen: set[str] = set()
        for uri in uris:
            kind = COMMAND if uri.startswith(COMMAND) else uri
            if kind not in (COMMAND, *_PLAIN) or kind in seen:
                raise ConfigurationError(
                    f"right {uri[:80]!r}: expected {COMMAND}1-3,7, {', '.join(_PLAIN[:-1])} or {_PLAIN[-1]}, each once"
                )
            seen.add(kind)
            if kind == COMMAND:
                drones = uri.removeprefix(COMMAND)
                command = None if drones == EVERY else parse_numbers(drones, MAX_DRONE, f"right {uri[:80]!r}")
        return cls(command, TAKE_OVER in seen, OBSERVE in seen, UPLOAD_PLAN in seen, SET_PARAMETERS in seen)


def _not_numbers(text: str, most: int, what: str) -> ConfigurationError:
    return ConfigurationError(f"{what}: {text[:80]!r}: expected numbers from 1 to {most}, as 1-3,7")
