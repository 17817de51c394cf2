"""Checks of user input: a mistake is one line that names the variable, its value and what was expected."""

from __future__ import annotations

import re

from ..errors import UserError


def whole_number(what: str, text: str, most: int, *, also: str = "") -> int:
    """Parse a number from 1 to `most`, of at most nine ASCII digits, leading zeros included. Raises UserError."""
    if not re.fullmatch(r"[0-9]{1,9}", text) or not 1 <= int(text) <= most:
        raise UserError(f"{what}={text[:40]}: expected a whole number from 1 to {most}{also}")
    return int(text)


def one_of(what: str, value: str, known: tuple[str, ...]) -> None:
    """Raise UserError for a value that is not in `known`."""
    if value not in known:
        raise UserError(f"{what}={value}: expected {'one of ' if len(known) > 1 else ''}{', '.join(known)}")
