"""Supervises an embedded Mosquitto: its configuration, its start, its end, and its restart when it dies."""

from __future__ import annotations

import asyncio
import ctypes
import logging
import shutil
import signal
import socket
import sys
import tempfile
from pathlib import Path

from ..errors import ConfigurationError
from ..security.broker import LIMITS, BrokerFiles

logger = logging.getLogger("mqttxt.broker")

FIRST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 5.0
STEADY_S = 10.0
"""A broker that ran this long is started again without a longer pause."""

CONFIGURATION = LIMITS + "listener {port} {host}\nallow_anonymous true\n"
RUNNING = " running"
"""How the line ends that Mosquitto 2 says once its listener is open."""


_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


def _end_with_parent() -> None:
    """In the child, before Mosquitto is there: SIGTERM when this process ends, however it does (prctl(2)).

    Otherwise a killed role's broker would live on and hold the port.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class EmbeddedBroker:
    """One Mosquitto on `host:port`, with `files` as a broker of the fleet. `run` keeps it running until cancelled."""

    def __init__(
        self,
        host: str,
        port: int,
        program: str = "mosquitto",
        instead: str = "--fog-broker",
        files: BrokerFiles | None = None,
    ) -> None:
        self.host = host
        self.port = port
        self._files = files
        self._scheme = "mqtt" if files is None else "mqtts"
        self._directory: Path | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._program = program
        self._instead = instead
        self._has_run = False

    @property
    def url(self) -> str:
        """Where the activator itself reaches the broker."""
        host = "127.0.0.1" if self.host in ("0.0.0.0", "") else self.host
        return f"{self._scheme}://{host}:{self.port}"

    def url_towards(self, host: str, port: int) -> str:
        """Where others reach the broker: on all interfaces, by the address of the one that leads to `host`.

        Where there is no way to `host` yet, by this machine's name: a fog may start before its uplink.
        """
        if self.host != "0.0.0.0":
            return self.url
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect((host, port))  # UDP: this only chooses the route
                name = str(probe.getsockname()[0])
            except OSError:
                name = socket.gethostname()
        return f"{self._scheme}://{name}:{self.port}"

    async def run(self) -> None:
        """Start Mosquitto and start it again when it ends; raises ConfigurationError when it cannot start.

        What ends by itself without ever having run cannot start. One that ran, or was killed, has to come back,
        however young it was: its age says more about the machine than about it.
        """
        program = shutil.which(self._program)
        if program is None:
            raise ConfigurationError(
                f"embedded broker: {self._program!r} is not installed; expected Mosquitto 2 on the PATH, "
                f"or {self._instead} with a broker that runs elsewhere"
            )
        with tempfile.TemporaryDirectory(prefix="mqttxt-broker-") as directory:
            self._directory = Path(directory)
            self._directory.chmod(0o755)
            await self._keep_running(program, self._write(self._directory))

    def _write(self, directory: Path) -> Path:
        if self._files is not None:
            return self._files.write(directory, self.host, self.port)
        path = directory / "mosquitto.conf"
        path.write_text(CONFIGURATION.format(host=self.host, port=self.port))
        path.chmod(0o644)
        return path

    def reload(self) -> None:
        """Let Mosquitto read its access list and the revocation list anew; raises ConfigurationError for bad files."""
        if self._files is not None and self._directory is not None:
            self._files.write_access(self._directory)
            if self._process is not None and self._process.returncode is None:
                self._process.send_signal(signal.SIGHUP)

    async def _keep_running(self, program: str, configuration: Path) -> None:
        loop = asyncio.get_running_loop()
        pause_s = FIRST_PAUSE_S
        while True:
            started = loop.time()
            code, last_line = await self._run_once(program, configuration)
            lasted_s = loop.time() - started
            if code >= 0 and not self._has_run:
                raise ConfigurationError(
                    f"embedded broker {self.host}:{self.port}: Mosquitto ended with code {code}: {last_line}"
                )
            pause_s = FIRST_PAUSE_S if lasted_s >= STEADY_S else min(2 * pause_s, LONGEST_PAUSE_S)
            logger.warning("embedded broker ended with code %d (%s); starting it again", code, last_line)
            await asyncio.sleep(pause_s)

    async def _run_once(self, program: str, configuration: Path) -> tuple[int, str]:
        """Run Mosquitto to its end; returns its exit code and the last line it said."""
        process = self._process = await asyncio.create_subprocess_exec(
            program,
            "-c",
            str(configuration),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            preexec_fn=_end_with_parent if sys.platform == "linux" else None,
        )
        last_line = ""
        try:
            assert process.stderr is not None
            async for line in process.stderr:
                last_line = line.decode(errors="replace").strip()
                self._has_run = self._has_run or last_line.endswith(RUNNING)
                logger.debug("mosquitto: %s", last_line)
            return await process.wait(), last_line
        finally:
            if process.returncode is None:
                process.terminate()
                await process.wait()
