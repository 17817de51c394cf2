"""The order in which a station's commands are started (docs/protocol.md, R5.4)."""

from __future__ import annotations

from ..core.highest import Highest
from ..core.ledger import CAPACITY, OVERRIDING
from ..core.overriding import SAFETY
from ..protocol.messages import CommandMessage


class StartOrder:
    """The newest command of each station's session that was started, and its newest hold, land or return.

    Each of them is in the ledger while an older command may still be in time, so no session has to make room too early.
    """

    def __init__(self) -> None:
        self._started = Highest[int](CAPACITY)
        self._halting = Highest[int](CAPACITY)

    def entered(self, command: CommandMessage) -> None:
        """Note that the ledger has taken a command, which may be denied."""
        if isinstance(command.command, OVERRIDING):
            self._halting.note(command.gs_session, command.seq)

    def started(self, command: CommandMessage) -> None:
        """Note that a command was started."""
        self._started.note(command.gs_session, command.seq)

    def is_overtaken(self, command: CommandMessage) -> bool:
        """Whether a newer command of its station's session was started or, unless it stops the drone, a newer hold,
        land or return has come.
        """
        is_halted = command.seq < self._halting.of(command.gs_session) and not isinstance(command.command, SAFETY)
        return is_halted or command.seq < self._started.of(command.gs_session)
