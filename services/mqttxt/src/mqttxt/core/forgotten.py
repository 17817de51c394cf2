"""Which commands may have been forgotten: the highest id that was, of each station's session (R5.10)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import starmap

from ..protocol.messages import CommandId


class Forgotten:
    """The highest forgotten id of each station's session, for as many sessions as there are `places`."""

    def __init__(self, places: int) -> None:
        self._places = places
        self._highest: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self._highest)

    def __iter__(self) -> Iterator[CommandId]:
        return starmap(CommandId, self._highest.items())

    def note(self, command_id: CommandId) -> bool:
        """Note an id; returns whether the session that was noted longest ago had to make room for it."""
        session = command_id.gs_session
        self._highest[session] = max(command_id.seq, self._highest.pop(session, -1))
        if len(self._highest) <= self._places:
            return False
        del self._highest[next(iter(self._highest))]
        return True

    def may_have(self, command_id: CommandId) -> bool:
        """Whether an id that is not known may have been: as high a one of its session, or a higher, was forgotten."""
        return command_id.seq <= self._highest.get(command_id.gs_session, -1)
