"""The allowed numbers and names in topics, and the prefixes of topics (docs/protocol.md, section 2)."""

from __future__ import annotations

import re
from numbers import Integral

from ..errors import ConfigurationError, PayloadError

MAX_DRONE = 250
MAX_FOG = 999_999_999
MAX_SENSOR = 999_999_999
MOST_ROOT_BYTES = 256
STATIONS = "gs"
NUMBER = re.compile(r"[1-9][0-9]{0,8}")
_FOG = re.compile(f"fog{NUMBER.pattern}")
NAME = "[A-Za-z0-9_.-]{1,64}"
"""Names of ground stations, commands and states, as a regular expression that JSON Schema and CDDL read too."""
NAME_EXPECTED = "1 to 64 characters out of letters, digits, '_', '.' and '-'"
_NAME = re.compile(NAME)
_KIND = re.compile(r"[a-z][a-z0-9_]{0,31}")


def check_root(root: str) -> str:
    """A root for topics, returned empty or ending in `/`. Raises ConfigurationError for one that breaks R2.2."""
    if root == "":
        return ""
    levels = root.removesuffix("/").split("/")
    is_right = all(level != "" and level.isprintable() and not set(level) & set("+#$") for level in levels)
    if not is_right or len(root.encode()) > MOST_ROOT_BYTES:
        raise ConfigurationError(
            f"topic prefix {root[:80]!r}: expected levels of printable characters without '+', '#' or '$', none of "
            f"them empty, as 'acme/', of at most {MOST_ROOT_BYTES} bytes"
        )
    return "/".join(levels) + "/"


def check_prefix(prefix: str) -> str:
    """A fleet's prefix at the cloud broker, as `check_root`, without `gs` and `fogX`. Raises ConfigurationError."""
    root = check_root(prefix)
    for level in root.split("/"):
        if level == STATIONS or _FOG.fullmatch(level):
            raise ConfigurationError(
                f"topic prefix {prefix!r}: {level} leads topics of a fleet; expected another level"
            )
    return root


def in_fleet(fleet: str, number: int) -> str:
    """The name of a drone or a fog: `acme/1`, or `1` if there is only one fleet."""
    return f"{fleet}/{number}" if fleet else f"{number}"


def parse_in_fleet(what: str, text: str, most: int = MAX_FOG) -> tuple[str, int]:
    """The fleet, empty for none, and the number in a name by `in_fleet`. Raises ConfigurationError."""
    fleet, slash, number = text.rpartition("/")
    if not NUMBER.fullmatch(number) or int(number) > most or (slash and (not fleet or fleet.endswith("/"))):
        expected = f"a whole number from 1 to {most}, with its fleet before it where there are several, as acme/1"
        raise ConfigurationError(f"{what} {text[:80]}: expected {expected}")
    return check_prefix(fleet).removesuffix("/"), int(number)


def check_station_name(name: str) -> str:
    """A ground station's name. Raises ConfigurationError if it cannot be a topic level."""
    if not _NAME.fullmatch(name):
        raise ConfigurationError(f"ground station name {name!r}: expected {NAME_EXPECTED}")
    return name


def check_number(what: str, value: int, most: int = MAX_FOG) -> int:
    """A fog's or drone's number. Raises ConfigurationError outside 1..most, and for what is no whole number."""
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not is_whole or not 1 <= value <= most:
        raise ConfigurationError(f"{what} {value!r}: expected a whole number from 1 to {most}")
    return int(value)


def check_kind(kind: str) -> str:
    """The kind of a sensor's readings, as a topic's last level. Raises PayloadError for an invalid one."""
    if not _KIND.fullmatch(kind):
        raise PayloadError(
            f"sensor kind {kind[:60]!r}: expected 1 to 32 lower-case letters, digits and '_', a letter first", "topic"
        )
    return kind
