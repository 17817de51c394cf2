"""Words and reasons that more than one node says, or judges by."""

from __future__ import annotations

from .messages import Word

NOT_IN_CONTROL = "not_in_control"
CERTIFICATE_EXPIRED = "certificate_expired"
"""Its station's certificate has ended: of the station only hold, land and return are taken."""
NOT_SIGNED = "not_signed"
"""The station has signed a broadcast for others, and not for this drone."""
NOT_ALLOWED = "not_allowed"
"""The station's certificate lacks a right, which the reason names."""
NOT_AUDITED = "audit"
"""The audit log takes no records, and was said to be required."""

PASSED_OVER = frozenset({Word.DENIED, Word.UNSUPPORTED, Word.EXPIRED, Word.UNREACHABLE})
"""Last words after which PSMI tries the next drone (R7.6). Not `overtaken`: the station itself sent a later command."""

NO_DEADLINE = "no_deadline"
"""Why a command without a deadline in the executor's clock is denied; a beacon goes with it."""
