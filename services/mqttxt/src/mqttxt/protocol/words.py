"""Words and reasons that more than one node uses."""

from __future__ import annotations

from .messages import Word

NOT_IN_CONTROL = "not_in_control"
CERTIFICATE_EXPIRED = "certificate_expired"
"""The station's certificate has expired: of its commands only hold, land and return are accepted."""
NOT_SIGNED = "not_signed"
"""The station has signed a broadcast for other drones, but not for this one."""
NOT_ALLOWED = "not_allowed"
"""The station's certificate lacks a right, which the reason names."""
NOT_AUDITED = "audit"
"""The audit log takes no records, and it is required."""

PASSED_OVER = frozenset({Word.DENIED, Word.UNSUPPORTED, Word.EXPIRED, Word.UNREACHABLE})
"""Last words after which PSMI tries the next drone (R7.6). Not `overtaken`: the station itself sent a newer command."""

NO_DEADLINE = "no_deadline"
"""The reason for denying a command without a deadline in the executor's clock; the result has a beacon."""
