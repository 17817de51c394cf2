"""A second ground station: MAVProxy beside a shared chain sees and arms six drones, as docs/mavlink.md tells."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.rigs.mavproxy import MavProxy
from tests.rigs.processes import free_port, stand_in
from tests.rigs.routers import Router

pytestmark = pytest.mark.integration
FOGS = {1: (1, 2, 3), 2: (4, 5, 6)}


@pytest.fixture(params=["beside MAVSDK", "instead of MAVSDK"])
def station(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[MavProxy]:
    """MAVProxy behind one router a node, as in a shared chain: six UAVs, two fogs, cloud, ground station.

    Beside MAVSDK it connects to the ground station's router; instead of it, it listens where MAVSDK would.
    """
    with ExitStack() as stack:
        here, gs, cloud = (free_port(socket.SOCK_DGRAM) for _ in range(3))
        routers = [
            Router(tmp_path, 201, f"udps:127.0.0.1:{gs}", f"udpc:127.0.0.1:{here}"),
            Router(tmp_path, 211, f"udps:127.0.0.1:{cloud}", f"udpc:127.0.0.1:{gs}"),
        ]
        sitls = []
        for fog, drones in FOGS.items():
            fog_port = free_port(socket.SOCK_DGRAM)
            routers.append(Router(tmp_path, 220 + fog, f"udps:127.0.0.1:{fog_port}", f"udpc:127.0.0.1:{cloud}"))
            for drone in drones:
                port = free_port(socket.SOCK_DGRAM)
                routers.append(Router(tmp_path, 230 + drone, f"udps:127.0.0.1:{port}", f"udpc:127.0.0.1:{fog_port}"))
                sitls.append(stand_in(tmp_path, drone, port, "--streams", "px4-normal"))
        for router in routers:
            stack.callback(router.start().kill)
        for sitl in sitls:
            stack.callback(sitl.start().kill)
        beside = request.param == "beside MAVSDK"
        made = MavProxy(tmp_path, f"udpout:127.0.0.1:{gs}" if beside else f"udpin:127.0.0.1:{here}")
        stack.callback(made.close)
        yield made


def test_mavproxy_sees_six_vehicles_and_arms_the_one_it_is_told_to(station: MavProxy, tmp_path: Path) -> None:
    station.choose(3, of=set(range(1, 7)))
    station.type_until_said("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
    armed = [drone for drone in range(1, 7) if "armed" in _events(tmp_path, drone)]
    assert armed == [3]


def _events(folder: Path, drone: int) -> list[str]:
    return [json.loads(line)["event"] for line in (folder / f"sitl{drone}.jsonl").read_text().splitlines()]
