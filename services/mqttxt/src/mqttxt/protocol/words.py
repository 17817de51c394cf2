"""Words and reasons that more than one node says, or judges by."""

from __future__ import annotations

from .messages import Word

NOT_IN_CONTROL = "not_in_control"

PASSED_OVER = frozenset({Word.DENIED, Word.UNSUPPORTED, Word.EXPIRED, Word.UNREACHABLE})
"""Last words after which PSMI tries the next drone (R7.6). Not `overtaken`: the station itself sent a later command."""

NO_DEADLINE = "no_deadline"
"""Why a command without a deadline in the executor's clock is denied; a beacon goes with it."""
