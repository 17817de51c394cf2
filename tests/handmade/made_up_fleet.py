"""Made-up containers and progress, for runs without Docker."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

from testbed.fly.calibration.calibrate import Calibration, Check
from testbed.fly.daemon import Usage
from testbed.plan.fleets import standard_fleet
from testbed.plan.overrides import compose_files

HERE = {"commit": "c0ffee", "dirty": False}
"""The revision of the working tree."""
MISSION_END = {"t_ns": 1, "event": "mission_end", "status": "completed", "reason": None}
SHAPER = {"shaper": "nfqueue", "why": "the kernel has no netem"}


class Quiet:
    """Progress that is only recorded."""

    def __init__(self) -> None:
        self.said: list[Any] = []

    def attempt(self, protocol: str, number: int, of: int, repeat: int) -> None:
        self.said.append((protocol, number, of, repeat))

    @contextlib.contextmanager
    def phase(self, text: str) -> Iterator[None]:
        self.said.append(text)
        yield

    def step(self, name: str, drones: dict[str, str], at_s: float) -> None:
        self.said.append((name, drones))

    def ended(self, status: str, reason: str | None) -> None:
        self.said.append((status, reason))


class Fleet:
    """Containers whose mission prints `lines` and ends with the exit code `code`, or raises `raises`."""

    def __init__(self, lines: list[str], code: int = 0, *, raises: Exception | None = None, dropped: int = 0) -> None:
        self.did: list[str] = []
        self._lines, self._code, self._raises, self._dropped = lines, code, raises, dropped
        self._run_dir = Path()
        self.profiles: list[str] = []
        self.commands: list[list[str]] = []
        self.settings: dict[str, str] = {}
        self.count = 23

    def __call__(self, profile: str, run_dir: Path, settings: dict[str, str], fleet: Any) -> Any:
        self._run_dir = run_dir
        compose_files(settings, fleet, run_dir)
        self.profiles.append(profile)
        self.settings = settings
        return self

    def start(self, *services: str) -> None:
        self.did.append("network" if "net" in services else "fleet")
        (self._run_dir / "links" / "shaper.json").write_text(json.dumps(SHAPER))

    def images(self) -> dict[str, str]:
        return {"node": "sha256:1"}

    def versions(self) -> dict[str, str]:
        return {"docker": "1"}

    def output(self, service: str, command: list[str]) -> str:
        return "mosquitto version 2.0.21\n"

    def execute(self, service: str, command: list[str], *, limit_s: float) -> Generator[str, None, int]:
        if command[0] == "sh":
            self.did.append("identities")
            return 0
        self.did.append(f"mission in {service}")
        self.commands.append(command)
        (self._run_dir / "events.jsonl").write_text(json.dumps(MISSION_END) + "\n")
        yield from self._lines
        if self._raises is not None:
            raise self._raises
        return self._code

    def usage(self) -> dict[str, Usage]:
        return {"gs": Usage(1.0, 4096), "net": Usage(2.0, None)}

    def stop(self, service: str) -> None:
        self.did.append(f"stop {service}")
        nodes = [node.name for node in standard_fleet().topology().nodes]
        counts = [{"node": node, "captured": 1, "dropped": self._dropped if node == "gs" else 0} for node in nodes]
        (self._run_dir / "pcap" / "captures.json").write_text(json.dumps(counts))
        for node in nodes:
            (self._run_dir / "pcap" / f"{node}.pcap").touch()
        self.count_links()

    def count_links(self, void: str | None = None) -> None:
        counters = {"version": 1, "shaper": "none", "profile": "ideal", "links": {}, "late_ms": None, "void": void}
        (self._run_dir / "links" / "counters.json").write_text(json.dumps(counters))

    def last_words(self, service: str) -> str | None:
        return None

    def save_logs(self, folder: Path) -> None:
        self.did.append("logs")

    def down(self) -> None:
        self.did.append("down")


CALIBRATED = Calibration("ideal", (Check("wan:gs:up", "delay_ms", 0.0, 0.1, -0.5, 0.5, 10, 10),), 1, 2.5)
OFF = Calibration("ideal", (Check("wan:gs:up", "delay_ms", 0.0, 9.0, -0.5, 0.5, 10, 10),), 3, 7.5)
