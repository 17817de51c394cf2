"""A drone's true position, in a file for other programs: by it the testbed opens a sensor's link."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from .errors import SitlError

EVERY_S = 0.2


class PositionFile:
    """One JSON object: t_ns (since 1970), latitude_deg, longitude_deg, altitude_m (above home).

    It is replaced as a whole, so that no reader sees half of it. Raises SitlError if it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._new = path.with_name(f"{path.name}.new")

    def write(self, state: dict[str, Any]) -> None:
        """Write the position from a drone's state, as the side channel reports it."""
        place = {name: state[name] for name in ("latitude_deg", "longitude_deg", "altitude_m")}
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._new.write_text(json.dumps({"t_ns": time.time_ns(), **place}) + "\n", encoding="ascii")
            self._new.replace(self._path)
        except OSError as error:
            raise SitlError(f"--position-file {self._path}: {error.strerror}") from error
