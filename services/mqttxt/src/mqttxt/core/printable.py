"""Text of others on a terminal or in a log: whatever it contains, it says only what it shows."""

from __future__ import annotations


def printable(text: str) -> str:
    """`text` with what is not shown (controls, escapes, directions, line ends) as a backslash sequence."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
