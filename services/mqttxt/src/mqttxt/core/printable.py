"""Foreign text made safe for a terminal or a log."""

from __future__ import annotations


def printable(text: str) -> str:
    """Return `text` with unprintable characters (controls, escapes, directions, line ends) as backslash sequences."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
