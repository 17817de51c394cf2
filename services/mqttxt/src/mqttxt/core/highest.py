"""The highest number that was noted of each key, for a limited number of keys."""

from __future__ import annotations

from collections.abc import Hashable, ItemsView
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)


class Highest(Generic[Key]):
    """The highest number of each key; above `places` keys the one that was noted longest ago makes room."""

    def __init__(self, places: int) -> None:
        self._places = places
        self._numbers: dict[Key, int] = {}

    def __len__(self) -> int:
        return len(self._numbers)

    def items(self) -> ItemsView[Key, int]:
        return self._numbers.items()

    def note(self, key: Key, number: int) -> bool:
        """Note a number; returns whether another key had to make room."""
        self._numbers[key] = max(number, self._numbers.pop(key, -1))
        if len(self._numbers) <= self._places:
            return False
        del self._numbers[next(iter(self._numbers))]
        return True

    def of(self, key: Key) -> int:
        """The highest number of a key, -1 if none is known."""
        return self._numbers.get(key, -1)
