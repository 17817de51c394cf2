"""Real processes for the integration tests: brokers, roles and autopilots, each on loopback, each ended by its id."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import IO, Any, Self

from tests.quick import LANDING, quick_fleet
from tests.rigs import prefork
from tests.rigs.loopback import PATIENCE_S as PATIENCE_S
from tests.rigs.loopback import eventually as eventually
from tests.rigs.loopback import free_block as free_block
from tests.rigs.loopback import free_port as free_port
from tests.rigs.loopback import listens as listens
from tests.rigs.loopback import wait_until as wait_until
from tests.rigs.prefork import ROOT, Running
from tests.tools.node_programs import MOSQUITTO


def commanded(events: Path, mav_cmd: int) -> list[dict[str, Any]]:
    """The events of a MAV_CMD in a stand-in's log, with their times."""
    lines = events.read_text().splitlines() if events.exists() else []
    found = [json.loads(line) for line in lines if line.endswith("}")]
    return [event for event in found if event["event"] == "command" and event["command"] == mav_cmd]


def ask_autopilot(control: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Ask a stand-in on its side channel, and return the answer."""
    with socket.socket(socket.AF_UNIX) as sock:
        sock.connect(str(control))
        sock.sendall(json.dumps(request).encode() + b"\n")
        answer: dict[str, Any] = json.loads(sock.makefile().readline())
        return answer


class Program:
    """A process that a test starts and ends; `log` has its output."""

    def __init__(self, folder: Path, name: str, *command: str) -> None:
        self.name = name
        self.log = folder / f"{name}.log"
        self._command = [*command]
        self._process: Running | None = None

    def start(self) -> Self:
        with self.log.open("ab") as log:
            self._process = self._start(log)
        return self

    def _start(self, log: IO[bytes]) -> Running:
        return subprocess.Popen(self._command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=ROOT)

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        return self._process.poll() if self._process is not None else None

    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def wait(self, limit_s: float = PATIENCE_S) -> int:
        assert self._process is not None
        return self._process.wait(limit_s)

    def kill(self) -> None:
        """Kill it by SIGKILL, as in a crash."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def stop(self) -> int:
        assert self._process is not None
        self._process.terminate()
        return self._process.wait(PATIENCE_S)

    def signal(self, number: signal.Signals) -> None:
        os.kill(self.pid, number)

    def stall(self) -> None:
        self.signal(signal.SIGSTOP)

    def go_on(self) -> None:
        self.signal(signal.SIGCONT)


class Broker(Program):
    """A real Mosquitto on a loopback port, of the nodes' version, or another `program`."""

    def __init__(self, folder: Path, name: str, program: str | None = None) -> None:
        self.port = free_port()
        self.configuration = folder / f"{name}.conf"
        self.configuration.write_text(
            f"{as_this_user()}persistence false\nlistener {self.port} 127.0.0.1\nallow_anonymous true\n"
            "set_tcp_nodelay true\n"
        )
        super().__init__(folder, name, program or str(MOSQUITTO), "-c", str(self.configuration))

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    def start(self) -> Self:
        super().start()
        wait_until(lambda: listens(self.port) or self.exit_code is not None, f"broker on port {self.port}")
        assert self.exit_code is None, self.said()
        return self


def as_this_user() -> str:
    """A line for Mosquitto's configuration: started as root, it would else change to a user who cannot read a test's
    folder.
    """
    return "user root\n" if os.geteuid() == 0 else ""


class Process(Program):
    """A Python module of the repository as a process of its own; mqttxt with `ppm` has a clock of its own too."""

    def __init__(self, folder: Path, name: str, module: str, *arguments: str, ppm: int | None = None) -> None:
        odd_clock = [sys.executable, str(Path(__file__).with_name("odd_clock.py")), str(ppm)]
        super().__init__(folder, name, *(odd_clock if ppm is not None else ()), *arguments)
        self.ready_file = folder / f"{name}.ready"
        self._module = module if ppm is None else None

    def _start(self, log: IO[bytes]) -> Running:
        return super()._start(log) if self._module is None else prefork.start(self._module, self._command, log, log)

    def with_more(self, *arguments: str) -> Self:
        """Add arguments; returns itself."""
        self._command += arguments
        return self

    def start(self) -> Self:
        self.ready_file.unlink(missing_ok=True)
        return super().start()

    def wait_ready(self) -> Self:
        wait_until(lambda: self.ready_file.exists() or self.exit_code is not None, f"{self.name} ready")
        assert self.exit_code is None, f"{self.name} ended: {self.said()[-2000:]}"
        return self

    def step_clock(self) -> None:
        """Step its session clock ahead (`odd_clock`)."""
        self.signal(signal.SIGUSR1)


def stand_in(
    folder: Path, drone: int, port: int, *more: str, name: str | None = None, fleet: Path | None = None
) -> Process:
    """A stand-in that sends to a port; its events are in NAME.jsonl, its side channel is NAME.sock."""
    called = name or f"sitl{drone}"
    base = str(folder / called)
    files = ["--events", f"{base}.jsonl", "--ready-file", f"{base}.ready", "--control", f"{base}.sock"]
    ends = ["--listen", "127.0.0.1:0", "--send", f"127.0.0.1:{port}"]
    of = ["--fleet", str(fleet or ROOT / "services" / "fleet.yaml"), "--system", str(drone)]
    return Process(folder, called, "sitl", "fly", *of, *ends, *files, *more)


class System:
    """A cloud broker, a fog broker, an activator and two drones with their autopilots, as real processes."""

    def __init__(
        self,
        folder: Path,
        qos: int = 1,
        streams: str = "px4-normal",
        fleet_file: Path | None = None,
        like: str = "px4",
    ) -> None:
        self.folder = folder
        self.like = like
        self.streams = streams
        self.fleet_file = fleet_file or quick_fleet(folder, LANDING if like == "px4" else {})
        self.cloud = Broker(folder, "cloud")
        self.fog = Broker(folder, "fog")
        self.autopilots = {drone: free_port(socket.SOCK_DGRAM) for drone in (1, 2)}
        self.sitls = {drone: self.make_sitl(drone) for drone in self.autopilots}
        self.qos = qos
        self.activator = self.make_activator(self.cloud.url, self.fog.url)
        self.uavs = {drone: self.make_uav(drone, self.fog.url) for drone in self.autopilots}

    def make_activator(self, cloud: str, fog: str, name: str = "activator", ppm: int | None = None) -> Process:
        ready = str(self.folder / f"{name}.ready")
        options = ["--fog", "1", "--cloud", cloud, "--fog-broker", fog, "--drones", "1,2", "--ready-file", ready]
        return Process(self.folder, name, "mqttxt", "activator", *options, "--qos", str(self.qos), ppm=ppm)

    def make_uav(
        self,
        drone: int,
        broker: str,
        name: str | None = None,
        autopilot_port: int | None = None,
        ppm: int | None = None,
    ) -> Process:
        called = name or f"uav{drone}"
        address = f"udp:127.0.0.1:{autopilot_port or self.autopilots[drone]}"
        options = ["--drone", str(drone), "--broker", broker, "--autopilot", address, "--qos", str(self.qos)]
        files = ["--journal", str(self.folder / called), "--ready-file", str(self.folder / f"{called}.ready")]
        return Process(self.folder, called, "mqttxt", "uav", *options, *files, ppm=ppm)

    def make_sitl(self, drone: int) -> Process:
        how = ["--streams", self.streams, "--like", self.like]
        return stand_in(self.folder, drone, self.autopilots[drone], *how, fleet=self.fleet_file)

    @property
    def brokers(self) -> tuple[Broker, ...]:
        """The brokers that it starts and ends."""
        return self.cloud, self.fog

    def start(self) -> Self:
        for broker in self.brokers:
            broker.start()
        for process in (*self.sitls.values(), self.activator, *self.uavs.values()):
            process.start()
        for process in (*self.sitls.values(), self.activator, *self.uavs.values()):
            process.wait_ready()
        return self

    def close(self) -> None:
        for process in (*self.uavs.values(), self.activator, *self.sitls.values()):
            process.kill()
        for broker in reversed(self.brokers):
            broker.kill()

    def commanded(self, drone: int, mav_cmd: int) -> list[dict[str, Any]]:
        """The events of a MAV_CMD that an autopilot received, with their times."""
        return commanded(self.folder / f"sitl{drone}.jsonl", mav_cmd)

    def control(self, drone: int, request: dict[str, Any]) -> dict[str, Any]:
        """Ask the autopilot on its side channel, and return the answer."""
        return ask_autopilot(self.folder / f"sitl{drone}.sock", request)
