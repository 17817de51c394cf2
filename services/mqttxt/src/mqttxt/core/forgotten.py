"""Which commands may have been forgotten: the highest id that was, of each station's session (R5.10)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import starmap

from ..protocol.messages import CommandId
from .highest import Highest


class Forgotten:
    """The highest forgotten id of each station's session, for as many sessions as there are `places`."""

    def __init__(self, places: int) -> None:
        self._highest = Highest[int](places)

    def __len__(self) -> int:
        return len(self._highest)

    def __iter__(self) -> Iterator[CommandId]:
        return starmap(CommandId, self._highest.items())

    def note(self, command_id: CommandId) -> bool:
        """Note an id; returns whether the session that was noted longest ago had to make room for it."""
        return self._highest.note(command_id.gs_session, command_id.seq)

    def may_have(self, command_id: CommandId) -> bool:
        """Whether an id that is not known may have been: as high a one of its session, or a higher, was forgotten."""
        return command_id.seq <= self._highest.of(command_id.gs_session)
