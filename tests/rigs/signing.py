"""MAVLink keys for tests."""

from __future__ import annotations

import secrets
from pathlib import Path

from mqttxt.drone.mavlink.signing import read_key


def make_key(path: Path) -> bytes:
    """A key in a new file, as `mqttxt keys mavlink` writes it."""
    path.write_text(secrets.token_hex(32))
    path.chmod(0o600)
    return read_key(path)
