"""A campaign on this machine: a scheduler and workers as processes, over TLS, with quick, made-up flights."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from io import StringIO
from pathlib import Path
from typing import Any

from rich.console import Console

from testbed.fly import runner
from testbed.fly.campaign.certificate import make_certificate, security_of
from testbed.fly.campaign.machines import fly_on_machines
from testbed.fly.campaign.run import SeriesSteps
from testbed.fly.results import Series
from testbed.fly.runner import Begun, run_series
from testbed.fly.validity import Verdict
from testbed.plan.experiments import Plan
from tests.handmade.finished import count_attempts
from tests.handmade.made_up_fleet import CALIBRATED, Fleet, Quiet
from tests.rigs.processes import ROOT, free_port, wait_until

STARTS_S = 90.0
MISSION_S = "1"
ATTEMPT_BYTES = 5_000_000
"""More than one part of a file."""


class _Slow(Fleet):
    """Made-up containers; the mission is a command that takes a moment."""

    def execute(self, service: str, command: list[str], *, limit_s: float) -> Any:
        (self._run_dir / "logs" / "big.log").write_bytes(os.urandom(ATTEMPT_BYTES))
        subprocess.run(["sleep", MISSION_S], check=True)
        return super().execute(service, command, limit_s=limit_s)


def fly_quickly(plan: Plan, series: Series, begun: dict[int, Begun]) -> list[Verdict]:
    """The workers' replacement for a flight, in the same kind of process."""
    runner.calibrate = lambda *_: CALIBRATED
    return run_series(plan, series, Quiet(), _Slow([]), begun)


QUICKLY = SeriesSteps(fly_quickly, count_attempts)


class Machines:
    """A scheduler, and workers by name, each with its log and its folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.certificate = folder / "campaign.pem"
        make_certificate(self.certificate)
        self.port = free_port()
        self.address = f"tls://127.0.0.1:{self.port}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start_scheduler(self) -> None:
        self._start("scheduler", "scheduler", "--port", str(self.port))
        wait_until(lambda: "scheduler: tls://" in self.said("scheduler"), "the scheduler is there", STARTS_S)

    def start_worker(self, name: str) -> None:
        self._start(name, "worker", "--scheduler", self.address, "--results", str(self.folder / "workers"))
        wait_until(lambda: "flies for" in self.said(name), f"{name} is there", STARTS_S)

    def kept_by(self, name: str) -> Path:
        """The folder of a worker's series that are not pushed yet."""
        return self.folder / "workers" / name

    def said(self, name: str) -> str:
        path = self.folder / f"{name}.log"
        return path.read_text() if path.exists() else ""

    def kill(self, name: str) -> None:
        self.processes[name].kill()
        self.processes[name].wait()

    def close(self) -> None:
        for process in self.processes.values():
            process.send_signal(signal.SIGTERM)
        for process in self.processes.values():
            process.wait(60)

    def _start(self, name: str, *words: str) -> None:
        command = [sys.executable, "-m", "testbed", *words, "--certificate", str(self.certificate)]
        with (self.folder / f"{name}.log").open("wb") as log:
            self.processes[name] = subprocess.Popen(
                command, cwd=ROOT, env={**os.environ, "MACHINE": name}, stdout=log, stderr=subprocess.STDOUT
            )


class Campaign:
    """`make all SCHEDULER=…` with quick flights, in a thread."""

    def __init__(self, plans: list[Plan], root: Path, machines: Machines) -> None:
        self._console = Console(file=StringIO(), width=300)
        self.counted: bool | None = None
        self.raised: BaseException | None = None
        self._thread = threading.Thread(target=self._fly, args=(plans, root, machines))
        self._thread.start()

    def said(self) -> str:
        assert isinstance(self._console.file, StringIO)
        return self._console.file.getvalue()

    def wait(self, limit_s: float = 180) -> None:
        self._thread.join(limit_s)
        assert not self._thread.is_alive(), self.said()

    def _fly(self, plans: list[Plan], root: Path, machines: Machines) -> None:
        try:
            security = security_of(machines.certificate)
            self.counted = fly_on_machines(plans, root, self._console, QUICKLY, machines.address, security)
        except BaseException as error:  # noqa: BLE001 - the test looks at it
            self.raised = error
