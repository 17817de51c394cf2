"""Where the stand-in stays apart from PX4, and why."""

from __future__ import annotations

APART: dict[tuple[str, str], str] = {}
"""By case and the beginning of a fact's name."""
