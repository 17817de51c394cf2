"""A container of the testbed's image, for tests of what only the image has or only a container shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import docker

from testbed.bootstrap.images import NODE


class Container:
    """A container of the testbed's image on the host's network; its output is kept in `log`."""

    def __init__(self, log: Path) -> None:
        self.log = log
        self._said_before = b""
        self._docker = docker.from_env()
        self._container: Any = None

    def run(self, command: list[str], **options: Any) -> None:
        self._container = self._docker.containers.run(NODE, command, network_mode="host", detach=True, **options)

    def execute(self, command: list[str], user: str) -> tuple[int, bytes]:
        code, output = self._container.exec_run(command, user=user)
        return code, output

    def kill(self) -> None:
        """End it at once, as a power loss would."""
        self.save_log()
        container, self._container = self._container, None
        if container is not None:
            self._said_before = self.log.read_bytes()
            container.remove(force=True)

    def ended(self) -> int | None:
        """Its exit code, None while it runs."""
        self._container.reload()
        return int(self._container.attrs["State"]["ExitCode"]) if self._container.status == "exited" else None

    def save_log(self) -> None:
        if self._container is not None:
            self.log.write_bytes(self._said_before + self._container.logs())

    def said(self) -> str:
        self.save_log()
        return self.log.read_text(errors="replace")
