"""The words about one command, as the kit received them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from . import shapes
from .fields import FIRST_WORDS
from .registry import Broken
from .tap import Heard


@dataclass
class Words:
    """The words about one command in order of arrival, with arrival times in the kit's clock."""

    words: list[dict[str, Any]]
    at_ms: list[int]

    @property
    def names(self) -> list[str]:
        return [word["word"] for word in self.words]

    @property
    def last(self) -> dict[str, Any] | None:
        return next((word for word in self.words if word["word"] not in FIRST_WORDS), None)

    @property
    def reason(self) -> Any:
        """The last word's reason, None without one."""
        return (self.last or {}).get("reason")

    def __str__(self) -> str:
        shown = [word["word"] + (f"({word['reason']})" if "reason" in word else "") for word in self.words]
        return ", ".join(shown) or "no word"


def words_of(results: Iterable[Heard], below: str, gs_session: int, seq: int) -> Words:
    """The words about one command id among results below a topic; raises Broken if such a result is malformed."""
    found = Words([], [])
    for heard in results:
        try:
            word = shapes.read("result", heard.payload)
        except Broken:
            if names(heard.payload, gs_session, seq):
                raise
            continue
        if (word["gs_session"], word["seq"]) == (gs_session, seq):
            word["topic"] = heard.topic.removeprefix(below)
            found.words.append(word)
            found.at_ms.append(heard.at_ms)
    return found


def names(payload: bytes, gs_session: int, seq: int) -> bool:
    """Whether a malformed payload still names a command id."""
    raw = shapes.plain(payload)
    if isinstance(raw, dict):
        return (raw.get("gs_session"), raw.get("seq")) == (gs_session, seq)
    return isinstance(raw, list) and raw[1:3] == [gs_session, seq]
