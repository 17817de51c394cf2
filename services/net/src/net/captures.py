"""One tcpdump for each port, which writes a pcap with nanosecond time stamps, and its counts of dropped packets."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from .interfaces import NetError, Port

BUFFER_KIB = 16_384
START_TIMEOUT_S = 15.0
STOP_TIMEOUT_S = 3.0
"""The limit for all captures together; less than the time that compose.yaml gives a container to end."""
_COUNTS = {
    "captured": re.compile(r"^(\d+) packets? captured", re.MULTILINE),
    "received": re.compile(r"^(\d+) packets? received by filter", re.MULTILINE),
    "dropped": re.compile(r"^(\d+) packets? dropped by kernel", re.MULTILINE),
}


@dataclass(frozen=True)
class Counts:
    """The counts that tcpdump prints for one capture when it ends; None if it printed none.

    `mac` is net's own: frames from it are sent to the node. `captured` packets are in the file; those `received`
    beyond them were still in the kernel's buffer at the end.
    """

    node: str
    interface: str
    mac: str
    captured: int | None
    received: int | None
    dropped: int | None


def capture_command(port: Port, folder: Path) -> list[str]:
    """tcpdump's arguments: whole frames, each written immediately.

    Without the immediate mode the kernel delivers frames up to a second late, and those of the last second are lost
    when the capture ends.
    """
    return [
        *("tcpdump", "--time-stamp-precision=nano", "--immediate-mode", "--packet-buffered", "--no-promiscuous-mode"),
        *("-Z", "root", "-B", str(BUFFER_KIB), "-s", "0", "-n"),
        *("-i", port.interface, "-w", str(folder / f"{port.node}.pcap")),
    ]


class Capture:
    """A running tcpdump on one port."""

    def __init__(self, port: Port, folder: Path) -> None:
        self.port = port
        self.said = ""
        self._listening = threading.Event()
        self._process = subprocess.Popen(
            capture_command(port, folder), stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def wait_until_listening(self) -> None:
        """Wait until tcpdump captures. Raises NetError if it does not start."""
        if not self._listening.wait(START_TIMEOUT_S) or self._process.poll() is not None:
            raise NetError(f"capture towards {self.port.node} did not start: {self.said.strip()}")

    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def interrupt(self) -> None:
        """Make the capture write its packets, print its counts, and end."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)

    def finish(self, deadline_s: float) -> Counts:
        """Wait for its counts; one that has not ended by `deadline_s` (monotonic clock) is killed and has no counts."""
        try:
            self._process.wait(max(0.0, deadline_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(STOP_TIMEOUT_S)
        return parse_counts(self.port, self.said)

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self.said += line
            if "listening on" in line:
                self._listening.set()
        self._listening.set()


def stop_all(captures: Sequence[Capture]) -> list[Counts]:
    """End all captures at the same time and return their counts."""
    for capture in captures:
        capture.interrupt()
    deadline_s = time.monotonic() + STOP_TIMEOUT_S
    return [capture.finish(deadline_s) for capture in captures]


def parse_counts(port: Port, said: str) -> Counts:
    """Parse the counts in tcpdump's last lines."""
    found = {name: pattern.search(said) for name, pattern in _COUNTS.items()}
    numbers = {name: int(match[1]) if match else None for name, match in found.items()}
    return Counts(port.node, port.interface, port.mac, **numbers)


def write_counts(counts: Sequence[Counts], path: Path) -> None:
    """Write `captures.json`, completely or not at all."""
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps([asdict(count) for count in counts], indent=1) + "\n")
    fresh.replace(path)
