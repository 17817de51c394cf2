"""Words and reasons that more than one node says, or judges by."""

from __future__ import annotations

from .messages import Word

NOT_IN_CONTROL = "not_in_control"

DEFINITE_NO = frozenset({Word.DENIED, Word.UNSUPPORTED, Word.EXPIRED, Word.UNREACHABLE})
"""Last words that say that the command was not started, and will not be."""

NO_DEADLINE = "no_deadline"
"""Why a command without a deadline in the executor's clock is denied; a beacon goes with it."""
