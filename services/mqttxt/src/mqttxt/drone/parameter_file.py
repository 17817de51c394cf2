"""The set of parameters that a station was given last, on the drone's disk, which may save reading it again."""

from __future__ import annotations

import logging
from pathlib import Path

from ..errors import ConfigurationError, PayloadError
from ..protocol.parameters import ParameterSet
from ..security import files

logger = logging.getLogger("mqttxt.parameters")
KEEP_EVERY_S = 5.0


class ParameterFile:
    """A set in a file. It is trusted only once the autopilot has given its hash; otherwise all is read anew."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.kept: ParameterSet | None = None
        try:
            if path.exists():
                self.kept = ParameterSet.unpacked(files.read(path))
        except (ConfigurationError, PayloadError) as error:
            logger.warning("parameters %s: %s; they are read anew", path, error)

    def keep(self, found: ParameterSet) -> None:
        """Write a set; blocks. Raises ConfigurationError if the write fails."""
        files.write(self._path, found.packed())
        self.kept = found
