"""The order in which a station's commands are started (docs/protocol.md, R5.4)."""

from __future__ import annotations

from ..core.ledger import KEEP_MS
from ..protocol.messages import CommandMessage

MOST_SESSIONS = 1000
"""Above this number, sessions without a command in the last ten minutes are forgotten."""


class StartOrder:
    """The newest started command of each station's session, kept while an older one may still be in time."""

    def __init__(self) -> None:
        self._highest: dict[int, tuple[int, int]] = {}

    def note(self, command: CommandMessage, now_ms: int) -> None:
        """Note that a command was started."""
        self._highest[command.gs_session] = (command.seq, now_ms)
        if len(self._highest) > MOST_SESSIONS:
            recent = {session: at for session, at in self._highest.items() if now_ms - at[1] <= KEEP_MS}
            self._highest = recent

    def is_overtaken(self, command: CommandMessage) -> bool:
        """Whether a newer command of its station's session was started."""
        return command.seq < self._highest.get(command.gs_session, (-1, 0))[0]
