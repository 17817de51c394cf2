"""Real mavp2p routers on loopback, from the image of the testbed's nodes."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Self

import docker


class Router:
    """One mavp2p with its endpoints, as the nodes run it: quiet, its heartbeats with a system id of its own."""

    def __init__(self, image: str, system_id: int, *endpoints: str) -> None:
        self._image = image
        self._arguments = ["--quiet", f"--hb-systemid={system_id}", *endpoints]
        self._container: Any = None

    def start(self) -> Self:
        self._container = docker.from_env().containers.run(
            self._image,
            self._arguments,
            entrypoint="mavp2p",
            network_mode="host",
            user="1000:1000",
            detach=True,
        )
        return self

    def kill(self) -> None:
        container, self._container = self._container, None
        if container is not None:
            container.remove(force=True)

    def said(self) -> str:
        """What it wrote, standard error included."""
        return str(self._container.logs().decode(errors="replace"))


def chain(image: str, ports: list[int], first_system_id: int = 201) -> list[Router]:
    """Routers between neighbours of `ports`, on loopback: each listens on one and goes on to the next.

    An autopilot sends to the first port, a ground station listens on the last.
    """
    return [
        Router(image, first_system_id + number, f"udps:127.0.0.1:{near}", f"udpc:127.0.0.1:{far}")
        for number, (near, far) in enumerate(pairwise(ports))
    ]
