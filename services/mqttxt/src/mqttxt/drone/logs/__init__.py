"""The autopilot's flight logs on the drone: read onto its own disk, and handed on in pieces (section 18)."""

from __future__ import annotations

DEFAULT_LIMIT_MB = 512
"""What the folder of logs may hold, in millions of bytes."""
