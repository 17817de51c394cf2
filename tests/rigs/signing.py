"""MAVLink keys for tests."""

from __future__ import annotations

import secrets
from pathlib import Path

from mqttxt.drone.mavlink.signing import read_key


def make_key(path: Path) -> bytes:
    """Write a key to a new file, as `mqttxt keys mavlink` does, and return it."""
    path.write_text(secrets.token_hex(32))
    path.chmod(0o600)
    return read_key(path)
