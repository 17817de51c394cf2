"""Mosquittos for the benchmarks, and processes' use of the machine."""

from __future__ import annotations

import os
from pathlib import Path

from mqttxt.core import mosquitto
from tests.rigs.processes import Broker, as_this_user, free_port

_TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")


class BenchBroker(Broker):
    """A Mosquitto configured as an embedded broker; `more` adds lines to that, `program` is another Mosquitto."""

    def __init__(self, folder: Path, name: str, more: str = "", program: str | None = None) -> None:
        super().__init__(folder, name, program)
        configuration = mosquitto.configuration("127.0.0.1", self.port)
        self.configuration.write_text(as_this_user() + configuration + more)


class TwoWayBroker(BenchBroker):
    """The same with a second listener in TLS, with an identity; clients there need one of the fleet."""

    def __init__(self, folder: Path, name: str, identity: Path) -> None:
        self._tls_port = free_port()
        files = {"cafile": "fleet", "certfile": "certificate", "keyfile": "identity", "crlfile": "revoked"}
        tls = "".join(f"{option} {identity}/{file}.pem\n" for option, file in files.items())
        listener = f"listener {self._tls_port} 127.0.0.1\nrequire_certificate true\ntls_version tlsv1.3\n"
        super().__init__(folder, name, listener + tls)

    @property
    def tls_url(self) -> str:
        return f"mqtts://localhost:{self._tls_port}"


def cpu_s(*pids: int) -> float:
    """User and system time that processes have used so far."""
    total = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        total += int(fields[11]) + int(fields[12])
    return total / _TICKS_A_SECOND


def rss_mb(pid: int) -> float:
    """Resident memory of a process, in megabytes (10^6 bytes)."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
