"""Two nodes and `net` between them in containers with compose.yaml's rights, to shape real packets."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.rigs.shaped_nodes import FOLDER, PYTHON, REPOSITORY, Running, ShapedNodes

FIRST_SUBNET = 128 + os.getpid() % 60 * 2
SUBNETS = {"gs": f"198.19.{FIRST_SUBNET}", "cloud": f"198.19.{FIRST_SUBNET + 1}"}
"""Two subnets for this process alone: others may run the same tests on the same machine."""
UP, DOWN = "wan:gs:up", "wan:gs:down"
PROBE = f"{REPOSITORY}/tests/rigs/link_probe.py"
LINKS = f"{FOLDER}/links"
CONTROL = f"{FOLDER}/net.sock"
AS_NEW = (
    "while ip rule del priority 100 2>/dev/null; do :; done;"
    " for tool in iptables iptables-legacy; do $tool -P FORWARD ACCEPT; $tool -F; $tool -X; done 2>/dev/null; true"
)
"""Removes what an earlier run left in a container that outlives it."""


@dataclass(frozen=True)
class Row:
    """A datagram that arrived; `sound` if none of its bits was flipped."""

    number: int
    sent_ns: int
    received_ns: int
    sound: bool

    @property
    def delay_ms(self) -> float:
        return (self.received_ns - self.sent_ns) / 1e6


class ShapedLink(ShapedNodes):
    """gs and cloud with one link each way; `shaping` runs the emulator of this source tree in `net`."""

    def __init__(self) -> None:
        super().__init__("shaped", SUBNETS, "gs-cloud")

    def shape(self, plan: object, counters: str = f"{FOLDER}/counters.json", **options: Any) -> tuple[int, str]:
        """Run an emulator that is expected to end of its own accord; returns its exit code and output."""
        self.write_plan(plan)
        return self.net(self.shape_command(counters), **options)

    def shaping(
        self, up: Mapping[str, Any], events: Sequence[Mapping[str, Any]] = (), down: Mapping[str, Any] | None = None
    ) -> Emulator:
        """Run the emulator on the direction `up`; without `down` the other direction is unshaped."""
        self.write_plan(plan_of(up, events, down))
        return Emulator(self, self.shape_command())

    def routing(self, plan: Mapping[str, Any], **run: Any) -> Emulator:
        """Run all of `net` on a run's plan: it routes, captures, and shapes in its emulator's process."""
        self.write_run(plan, **run)
        return Emulator(self, self.route_command())

    def route(self, plan: object, run: Mapping[str, Any] | None = None, **options: Any) -> tuple[int, str]:
        """Run a `net route` that is expected to end of its own accord; returns its exit code and output."""
        self.write_run(plan, **(run or {}))
        return self.net(self.route_command(), **options)

    def net(self, command: Sequence[str], **options: Any) -> tuple[int, str]:
        """Run a command in `net`; returns its exit code and output."""
        done = self.nodes["net"].exec_run(list(command), environment=self.environment, **options)
        return done.exit_code, done.output.decode()

    def write_run(self, plan: object, **run: Any) -> None:
        """Make a run's folder of links with nothing but its plan, and one for positions."""
        self.output("net", ["sh", "-c", AS_NEW])
        folders = f"rm -rf {FOLDER} && mkdir -m 777 -p {LINKS} {FOLDER}/sitl"
        text = json.dumps({"version": 1, "shaper": "auto", "always": False, "gates": [], **run, "plan": plan})
        self.output("net", ["sh", "-c", f'{folders} && printf %s "$1" > {LINKS}/plan.json', "sh", text])

    def route_command(self) -> list[str]:
        """`net route` on the run's folder."""
        files = {"captures": f"{FOLDER}/pcap", "links": LINKS, "control": CONTROL, "ready-file": f"{FOLDER}/ready"}
        return [PYTHON, "-m", "net", "route", *(word for name, file in files.items() for word in (f"--{name}", file))]


class Emulator(Running):
    """A running `net shape`, and what is sent over its links."""

    def flow(self, count: int, rate_hz: float, size: int, silence_s: float = 1.0) -> list[Row]:
        """Send datagrams from gs to cloud, in packets of `size` bytes; returns those that arrived, in that order."""
        return self._flow("gs", "cloud", count, rate_hz, size, silence_s)

    def flow_back(self, count: int, rate_hz: float, size: int, silence_s: float = 1.0) -> list[Row]:
        """The same from cloud to gs."""
        return self._flow("cloud", "gs", count, rate_hz, size, silence_s)

    def send(self, count: int, rate_hz: float, size: int) -> None:
        """Send from gs to cloud without receiving there."""
        self._send("gs", "cloud", count, rate_hz, size)

    def _flow(self, source: str, to: str, count: int, rate_hz: float, size: int, silence_s: float) -> list[Row]:
        command = [PYTHON, PROBE, "receive", str(silence_s)]
        said = self._net.nodes[to].exec_run(command, stream=True).output
        first = next(said)
        assert first.startswith(b"listening"), first.decode()
        self._send(source, to, count, rate_hz, size)
        lines = b"".join([first, *said]).decode().splitlines()[1:]
        rows = [[int(word) for word in line.split()] for line in lines]
        return [Row(number, sent, received, bool(sound)) for number, sent, received, sound in rows]

    def _send(self, source: str, to: str, count: int, rate_hz: float, size: int) -> None:
        self._net.output(source, [PYTHON, PROBE, "send", f"{SUBNETS[to]}.3", str(count), str(rate_hz), str(size)])

    def kill_emulator(self) -> None:
        """Kill the process that shapes for a running `net route`, without a warning."""
        children = f"$(cat /proc/{self._pid}/task/*/children)"
        find = f"for pid in {children}; do grep -qa shape /proc/$pid/cmdline && echo $pid; done"
        (pid,) = self._net.output("net", ["sh", "-c", f"{find}; true"]).split()
        self._net.output("net", ["sh", "-c", f"kill -KILL {pid}"])

    def cpu_s(self) -> float:
        """User and system time of the process so far."""
        fields = self._net.output("net", ["cat", f"/proc/{self._pid}/stat"]).rsplit(") ", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def read(self, name: str) -> str:
        """The text of a file in the folder of links, else in the emulator's own folder."""
        return self._net.output("net", ["sh", "-c", f"cat {LINKS}/{name} 2>/dev/null || cat {FOLDER}/{name}"])


def plan_of(
    up: Mapping[str, Any], events: Sequence[Mapping[str, Any]] = (), down: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """A plan of two links."""
    links = {UP: dict(up), DOWN: dict(down or {})}
    return {"version": 1, "profile": "test", "seed": 5, "links": links, "events": list(events)}
