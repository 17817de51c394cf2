"""The tutorial's commands and the API's example, run just as they stand in docs/."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import pytest

from mqttxt.demo.process import CLOUD_PORT
from tests.rigs.demonstration import Desk
from tests.rigs.processes import ROOT, System, free_port, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.apart]
TYPED = pytest.mark.soak(
    *("docs/tutorial.md", "docs/api.md", "services/sitl/src/sitl/cli.py"),
    *(f"services/mqttxt/src/mqttxt/{part}" for part in ("cli", "demo", "station")),
)

DOCS = ROOT / "docs"
BLOCK = re.compile(r"<!-- tutorial: (?P<how>[^\n]*) -->\n```sh\n(?P<text>.*?)```", re.DOTALL)
SAYS = re.compile(r'(?:says|until) "(.*)"')
DISARMED_ITSELF = "takeoff denied(disarmed)"
DEMO = f"mqtt://127.0.0.1:{CLOUD_PORT}"
EXIT_CODE = re.compile(r"exit code (\d+)")


@dataclass(frozen=True)
class Step:
    """A block of the tutorial, and what becomes of it."""

    how: str
    text: str

    @property
    def says(self) -> str | None:
        found = SAYS.search(self.how)
        return found[1] if found else None

    @property
    def exit_code(self) -> int:
        found = EXIT_CODE.search(self.how)
        return int(found[1]) if found else 0


def steps() -> list[Step]:
    """The tutorial's blocks, each port replaced by one that nobody uses."""
    text = (DOCS / "tutorial.md").read_text()
    ports = {old: str(free_port()) for old in ("1892", "1893", "1894", "1895")}
    ports |= {old: str(free_port(socket.SOCK_DGRAM)) for old in ("14540", "14541", "14542", "14580", "14581", "14582")}
    for old, new in ports.items():
        text = re.sub(rf"\b{old}\b", new, text)
    return [Step(block["how"], block["text"]) for block in BLOCK.finditer(text)]


@dataclass
class Laptop:
    """Terminals in which a person's commands run; `mosquitto` and `mqttxt` are on the PATH."""

    folder: Path
    demo: str = DEMO
    """Where the demo's cloud broker is: another test may have the port that the page names."""
    terminals: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.environment = Desk(self.folder).environment

    def open(self, step: Step) -> None:
        """Run a block in a terminal of its own, and wait until it says what it should."""
        log = self.folder / f"terminal{len(self.terminals)}.log"
        with log.open("wb") as output:
            terminal = subprocess.Popen(
                ["bash", "-c", step.text],
                cwd=ROOT,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        self.terminals.append(terminal)
        wait_until(lambda: terminal.poll() is not None or (step.says or "") in log.read_text(), f"{step}: {log}")
        assert terminal.poll() is None, log.read_text()
        if found := re.search(r"MQTTXT_CLOUD=(\S+)", log.read_text()):
            self.demo = found[1]

    def run(self, step: Step) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["bash", "-c", step.text.replace(DEMO, self.demo)],
            cwd=ROOT,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=100,
            check=False,
        )

    def close(self) -> None:
        for terminal in reversed(self.terminals):
            if terminal.poll() is None:
                os.killpg(terminal.pid, signal.SIGTERM)
        for terminal in self.terminals:
            terminal.wait(30)


@pytest.fixture
def laptop(tmp_path: Path) -> Iterator[Laptop]:
    with closing(Laptop(tmp_path)) as made:
        yield made


@TYPED
@pytest.mark.timeout(400)
def test_the_tutorial_is_true(laptop: Laptop) -> None:
    found = steps()
    assert {step.how.split(",")[0] for step in found} == {"by hand", "terminal", "run"}
    for before, step in pairwise([found[0], *found]):
        if step.how.startswith("terminal"):
            laptop.open(step)
        elif step.how.startswith("run"):
            done = laptop.run(step)
            while DISARMED_ITSELF in done.stdout:  # "if you took longer, arm again", says the page
                laptop.run(before)
                done = laptop.run(step)
            assert done.returncode == step.exit_code, f"{step.text}\n{done.stdout}"
            assert step.says is not None
            assert step.says in done.stdout


def test_every_command_of_the_tutorial_is_run_or_marked() -> None:
    """No block of shell without its marker."""
    text = (DOCS / "tutorial.md").read_text()
    assert text.count("```sh") == len(BLOCK.findall(text))


@TYPED
@pytest.mark.timeout(240)
def test_the_programs_of_the_api_page_fly(system: System, tmp_path: Path) -> None:
    programs = re.findall(r"```python\n(.*?)```", (DOCS / "api.md").read_text(), re.DOTALL)
    said = []
    for number, program in enumerate(programs):
        path = tmp_path / f"program{number}.py"
        path.write_text(program.replace("mqtt://127.0.0.1:1894", system.cloud.url))
        done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=100, check=False)
        assert done.returncode == 0, done.stderr
        said.append(done.stdout)
    first, second = said
    assert "drone 1: land completed" in first
    assert "drone 1: goto completed" in second
    assert "drone 2: land completed" in second
