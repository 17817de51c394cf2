"""A run as people type it, for the tests that fly: its process, its containers, its attempts."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import docker
import yaml

from testbed.fly.containers import PROJECT, PROJECT_LABEL, SERVICE_LABEL
from testbed.fly.results import Attempt, open_series
from testbed.plan.documents import ROOT
from testbed.plan.fleets import standard_fleet
from tests.lateness import Void
from tests.quick import FLYING, quick_fleet

BUSY = ("did not keep up", "machine was too busy", "machine that is less busy", "captures dropped packets")
"""What the testbed says of an attempt that is void because of the machine."""
FEW = 3
"""Drones of a small fleet, of which one fog has two and the other one."""


def containers() -> dict[str, Any]:
    found = docker.from_env().containers.list(all=True, filters={"label": f"{PROJECT_LABEL}={PROJECT}"})
    return {container.labels[SERVICE_LABEL]: container for container in found}


def quick_drones(folder: Path) -> dict[str, str]:
    """The environment in which the fleet flies quickly; what the testbed makes of it is in `folder`."""
    mounted = {"volumes": [f"{quick_fleet(folder, FLYING)}:/opt/services/fleet.yaml:ro"]}
    services = {f"sitl{drone}": mounted for drone in standard_fleet().fog_of}
    (folder / "quick.yaml").write_text(yaml.safe_dump({"services": services}))
    return {"AUTOPILOT": str(folder / "quick.yaml")}


def few_drones(folder: Path) -> dict[str, str]:
    """The environment in which a smaller fleet flies quickly, FEW drones at two fogs: it is up in half the time."""
    return {"FLEET": str(quick_fleet(folder, FLYING)), "FOGS": "2", "DRONES": str(FEW)}


class Run:
    """`testbed run` of an experiment, or `testbed fly` of a file, as a process whose lines can be waited for."""

    def __init__(
        self,
        results: Path,
        *options: str,
        experiment: str = "scenario-1",
        verb: str = "run",
        environment: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        command = [sys.executable, "-m", "testbed", verb, experiment, "--results", str(results), *options]
        self.experiment = Path(experiment).stem
        self.results = results
        self.lines: list[str] = []
        self._said = threading.Condition()
        self._is_over = False
        self._process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, **environment, "COLUMNS": "120"},
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._said:
                self.lines.append(line.rstrip())
                self._said.notify_all()
        with self._said:
            self._is_over = True
            self._said.notify_all()

    @property
    def output(self) -> str:
        return "\n".join(self.lines)

    def wait_for(self, condition: Callable[[], bool], limit_s: float = 120) -> None:
        """Until the lines fulfil it; ends the run after the limit, with Void where an attempt is void."""
        with self._said:
            self._said.wait_for(lambda: condition() or self._is_over or self._voids != [], limit_s)
            if condition():
                return
        self.interrupt()
        self.wait(60)
        if self._voids:
            raise Void(self._voids[0].strip())
        raise AssertionError(self.output)

    @property
    def _voids(self) -> list[str]:
        return [line for line in self.lines if line.startswith("  void: ") and is_the_machines(line)]

    def says(self, text: str) -> None:
        self.wait_for(lambda: any(text in line for line in self.lines))

    def interrupt(self) -> None:
        self._process.send_signal(signal.SIGINT)

    def wait(self, limit_s: float = 500) -> int:
        """Its exit code, once all its lines are read; raises Void where of a side no attempt counts."""
        code = self._process.wait(limit_s)
        self._reader.join()
        reason = void_reason(self.metrics()) if (self.latest / "metrics.json").exists() else None
        if reason is not None:
            raise Void(reason)
        return code

    @property
    def latest(self) -> Path:
        """The folder of the series."""
        return self.results / self.experiment / "latest"

    def metrics(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.latest / "metrics.json").read_text())
        return found


def void_reason(metrics: dict[str, Any]) -> str | None:
    """Why the machine let no attempt of a side count; None where one does, or where it was not the machine."""
    sides = metrics["protocols"]
    if all(side["attempts"] or not side["void"] for side in sides.values()):
        return None
    reasons = [f"{protocol}: {one['reason']}" for protocol, side in sides.items() for one in side["void"]]
    return next(filter(is_the_machines, reasons), None)


def is_the_machines(reason: str) -> bool:
    """Whether an attempt is void because the machine was too busy, and not by a defect of the testbed."""
    return any(words in reason for words in BUSY)


def attempt_over(run: Run, protocol: str) -> Attempt:
    """The one that counts of a run of one attempt: a busy machine makes some void, and they are flown again."""
    *_, found = (one for one in open_series(run.latest).attempts() if one.protocol == protocol)
    return found
