"""The autopilot's flight logs: read onto the drone's disk, and given to stations in pieces (section 18)."""

from __future__ import annotations

DEFAULT_LIMIT_MB = 512
"""The most that the folder of logs may hold, in millions of bytes."""
