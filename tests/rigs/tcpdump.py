"""What goes over loopback, captured by the testbed image's tcpdump."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import docker
from docker.models.containers import Container

from testbed.bootstrap.images import NODE
from tests.rigs.processes import wait_until


class Tcpdump:
    """Writes the frames that are `wanted` into a file, from its entering on; the file is whole after `end`."""

    _container: Container

    def __init__(self, file: Path, wanted: str, *options: str) -> None:
        self._file = file
        self._words: Sequence[str] = [*options, "-w", f"/pcap/{file.name}", wanted]

    def __enter__(self) -> Self:
        self._file.parent.chmod(0o777)
        self._container = docker.from_env().containers.run(
            NODE,
            ["-i", "lo", "-U", "--immediate-mode", "-Z", "root", *self._words],
            entrypoint="tcpdump",
            network_mode="host",
            user="0:0",
            cap_add=["NET_RAW", "NET_ADMIN"],
            volumes={str(self._file.parent): {"bind": "/pcap", "mode": "rw"}},
            detach=True,
        )
        wait_until(lambda: b"listening on" in self._container.logs(), "tcpdump listens")
        return self

    def count(self) -> None:
        """Let it say what was dropped so far."""
        self._container.kill(signal="SIGUSR1")
        wait_until(self.dropped, "tcpdump has counted")

    def dropped(self) -> list[int]:
        """Frames that the kernel dropped, each time that tcpdump said it."""
        return [int(number) for number in re.findall(rb"(\d+) packets dropped by kernel", self._container.logs())]

    def end(self) -> None:
        self._container.kill(signal="SIGINT")
        self._container.wait()

    def __exit__(self, *_: object) -> None:
        self._container.remove(force=True)
