"""What was said of one command, as the kit heard it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from . import shapes


@dataclass
class Words:
    """What was said of one command, in its order; `at_ms` of each in the kit's clock."""

    words: list[dict[str, Any]]
    at_ms: list[int]

    @property
    def names(self) -> list[str]:
        return [word["word"] for word in self.words]

    @property
    def last(self) -> dict[str, Any] | None:
        return next((word for word in self.words if word["word"] not in shapes.FIRST_WORDS), None)

    def __str__(self) -> str:
        shown = [word["word"] + (f"({word['reason']})" if "reason" in word else "") for word in self.words]
        return ", ".join(shown) or "no word"
