"""Real mavp2p routers on loopback, of the nodes' version."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from tests.rigs.processes import Program
from tests.tools.node_programs import MAVP2P


class Router(Program):
    """One mavp2p with its endpoints, as the nodes run it: quiet, its heartbeats with a system id of its own."""

    def __init__(self, folder: Path, system_id: int, *endpoints: str) -> None:
        options = ["--quiet", f"--hb-systemid={system_id}"]
        super().__init__(folder, f"router{system_id}", str(MAVP2P), *options, *endpoints)


def chain(folder: Path, ports: list[int], first_system_id: int = 201) -> list[Router]:
    """Routers between neighbours of `ports`, on loopback: each listens on one and sends to the next.

    An autopilot sends to the first port, a ground station listens on the last.
    """
    return [
        Router(folder, first_system_id + number, f"udps:127.0.0.1:{near}", f"udpc:127.0.0.1:{far}")
        for number, (near, far) in enumerate(pairwise(ports))
    ]
