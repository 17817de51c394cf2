"""A plain Mosquitto: the program on the PATH, else the testbed's image."""

from __future__ import annotations

import shutil
import subprocess
from typing import Self

from tests.rigs.processes import Broker, wait_until


class LocalBroker(Broker):
    """As `Broker`, without a container where Mosquitto is installed."""

    _process: subprocess.Popen[bytes] | None = None

    @classmethod
    def like(cls, other: Broker) -> Self:
        """With the port and the configuration of one that was not started."""
        made = cls.__new__(cls)
        made.__dict__.update(other.__dict__)
        return made

    def start(self) -> Self:
        program = shutil.which("mosquitto")
        if program is None:
            return super().start()
        with self.log.open("ab") as log:
            self._process = subprocess.Popen([program, "-c", str(self.configuration)], stdout=log, stderr=log)
        wait_until(self._listens, f"broker on port {self.port}")
        return self

    def kill(self) -> None:
        if self._process is None:
            super().kill()
            return
        self._process.kill()
        self._process.wait()
        self._process = None
