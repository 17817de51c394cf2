"""One tcpdump for each port: pcap with nanosecond time stamps, and what it dropped."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import threading
from dataclasses import asdict, dataclass
from pathlib import Path

from .interfaces import NetError, Port

BUFFER_KIB = 16_384
START_TIMEOUT_S = 15.0
STOP_TIMEOUT_S = 15.0
_COUNTS = {
    "captured": re.compile(r"^(\d+) packets? captured", re.MULTILINE),
    "received": re.compile(r"^(\d+) packets? received by filter", re.MULTILINE),
    "dropped": re.compile(r"^(\d+) packets? dropped by kernel", re.MULTILINE),
}


@dataclass(frozen=True)
class Counts:
    """What tcpdump says of one capture when it ends; None where it did not say."""

    node: str
    interface: str
    captured: int | None
    received: int | None
    dropped: int | None


class Capture:
    """A running tcpdump on one port."""

    def __init__(self, port: Port, folder: Path) -> None:
        self.port = port
        self.said = ""
        self._listening = threading.Event()
        options = ["--time-stamp-precision=nano", "--packet-buffered", "--no-promiscuous-mode", "-Z", "root"]
        target = ["-B", str(BUFFER_KIB), "-s", "0", "-n", "-i", port.interface, "-w", str(folder / f"{port.node}.pcap")]
        self._process = subprocess.Popen(
            ["tcpdump", *options, *target], stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def wait_until_listening(self) -> None:
        """Raises NetError when tcpdump does not start to capture."""
        if not self._listening.wait(START_TIMEOUT_S) or self._process.poll() is not None:
            raise NetError(f"capture towards {self.port.node} did not start: {self.said.strip()}")

    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def stop(self) -> Counts:
        """End the capture by SIGINT, so that it writes what it has and says what it dropped."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        self._process.wait(STOP_TIMEOUT_S)
        self._reader.join(STOP_TIMEOUT_S)
        return parse_counts(self.port, self.said)

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self.said += line
            if "listening on" in line:
                self._listening.set()
        self._listening.set()


def parse_counts(port: Port, said: str) -> Counts:
    """The counts in tcpdump's last words."""
    found = {name: pattern.search(said) for name, pattern in _COUNTS.items()}
    numbers = {name: int(match[1]) if match else None for name, match in found.items()}
    return Counts(port.node, port.interface, **numbers)


def write_counts(counts: list[Counts], path: Path) -> None:
    """Write `captures.json`, whole or not at all."""
    fresh = path.with_suffix(".new")
    fresh.write_text(json.dumps([asdict(count) for count in counts], indent=1) + "\n")
    fresh.replace(path)
