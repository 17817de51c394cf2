"""A second ground station: MAVProxy beside a shared chain sees and arms six drones, as docs/mavlink.md tells."""

from __future__ import annotations

import json
import math
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tests.rigs.processes import NODE_IMAGE, PATIENCE_S, ROOT, Process, free_port, wait_until
from tests.rigs.routers import Router

pytestmark = pytest.mark.integration
REQUIREMENTS = ROOT / "requirements" / "mavproxy.txt"
FOGS = {1: (1, 2, 3), 2: (4, 5, 6)}
SEEN = re.compile(r"Detected vehicle (\d+):1 on link 0")


@pytest.fixture(scope="session")
def mavproxy() -> Path:
    """MAVProxy's wheel, which runs as it is; downloaded once, as pinned."""
    folder = ROOT / ".cache" / "mavproxy"
    version = re.search(r"mavproxy==(\S+)", REQUIREMENTS.read_text())
    assert version is not None
    wheel = folder / f"mavproxy-{version[1]}-py3-none-any.whl"
    if not wheel.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=folder) as new:  # another worker may be at it too
            options = ["--quiet", "--require-hashes", "--no-deps", "--only-binary", ":all:", "--dest", new]
            pip = [sys.executable, "-m", "pip", "download", *options, "--requirement", str(REQUIREMENTS)]
            subprocess.run(pip, check=True)
            (Path(new) / wheel.name).replace(wheel)
    return wheel


class Station:
    """A MAVProxy; what it says is kept, and it can be typed to."""

    def __init__(self, wheel: Path, folder: Path, master: str) -> None:
        options = ["--master", master, "--nowait", "--state-basedir", str(folder)]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "MAVProxy.mavproxy", *options],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(wheel), "PYTHONUNBUFFERED": "1", "HOME": str(folder)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.said = ""
        self._log = folder / "mavproxy.log"
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def type_until_said(self, line: str, answer: str) -> None:
        """As a person would: MAVProxy sends a command once, and a busy router drops what it has no room for."""
        typed_s = -math.inf

        def answered() -> bool:
            nonlocal typed_s
            if answer not in self.said and time.monotonic() > typed_s + PATIENCE_S / 5:
                self.type(line)
                typed_s = time.monotonic()
            return answer in self.said

        wait_until(answered, f"{line!r} is answered: {answer}")

    def type(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()

    def vehicles(self) -> set[int]:
        return {int(found) for found in SEEN.findall(self.said)}

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._log.open("w", buffering=1) as log:
            for line in self._process.stdout:
                self.said += line
                log.write(line)


@pytest.fixture(params=["beside MAVSDK", "instead of MAVSDK"])
def station(request: pytest.FixtureRequest, mavproxy: Path, tmp_path: Path) -> Iterator[Station]:
    """MAVProxy behind one router a node, as in a shared chain: six UAVs, two fogs, cloud, ground station.

    Beside MAVSDK it connects to the ground station's router; instead of it, it listens where MAVSDK would.
    """
    with ExitStack() as stack:
        here, gs, cloud = (free_port(socket.SOCK_DGRAM) for _ in range(3))
        routers = [
            Router(NODE_IMAGE, 201, f"udps:127.0.0.1:{gs}", f"udpc:127.0.0.1:{here}"),
            Router(NODE_IMAGE, 211, f"udps:127.0.0.1:{cloud}", f"udpc:127.0.0.1:{gs}"),
        ]
        sitls = []
        for fog, drones in FOGS.items():
            fog_port = free_port(socket.SOCK_DGRAM)
            routers.append(Router(NODE_IMAGE, 220 + fog, f"udps:127.0.0.1:{fog_port}", f"udpc:127.0.0.1:{cloud}"))
            for drone in drones:
                port = free_port(socket.SOCK_DGRAM)
                routers.append(Router(NODE_IMAGE, 230 + drone, f"udps:127.0.0.1:{port}", f"udpc:127.0.0.1:{fog_port}"))
                sitls.append(_sitl(tmp_path, drone, port))
        for router in routers:
            stack.callback(router.start().kill)
        for sitl in sitls:
            stack.callback(sitl.start().kill)
        beside = request.param == "beside MAVSDK"
        made = Station(mavproxy, tmp_path, f"udpout:127.0.0.1:{gs}" if beside else f"udpin:127.0.0.1:{here}")
        stack.callback(made.close)
        yield made


def test_mavproxy_sees_six_vehicles_and_arms_the_one_it_is_told_to(station: Station, tmp_path: Path) -> None:
    wait_until(lambda: station.vehicles() == set(range(1, 7)), "six vehicles", 60)
    station.type("vehicle 3:1")  # its autopilot: alone, the component stays that of whoever was heard first
    wait_until(lambda: "Set vehicle 3:1" in station.said, "vehicle 3 is chosen")
    station.type_until_said("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
    armed = [drone for drone in range(1, 7) if "armed" in _events(tmp_path, drone)]
    assert armed == [3]


def _sitl(folder: Path, drone: int, port: int) -> Process:
    fleet = ["--fleet", str(ROOT / "services" / "fleet.yaml"), "--system", str(drone)]
    where = ["--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{port}", "--streams", "px4-normal"]
    return Process(folder, f"sitl{drone}", "sitl", "fly", *fleet, *where, "--events", str(folder / f"{drone}.jsonl"))


def _events(folder: Path, drone: int) -> list[str]:
    return [json.loads(line)["event"] for line in (folder / f"{drone}.jsonl").read_text().splitlines()]
