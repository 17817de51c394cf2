"""Supervises an embedded Mosquitto: its configuration, its start, its end, and its restart when it dies."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import signal
import socket
import tempfile
from pathlib import Path

from ..errors import ConfigurationError
from ..security.broker import BrokerFiles
from ..security.revocation import RevocationList
from . import mosquitto
from .address import host_port, is_taken
from .children import ENDS_WITH_PARENT, ending_with_parent
from .disk import is_fault

logger = logging.getLogger("mqttxt.broker")

_OWN = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""How this machine reaches a broker that listens on all interfaces."""
FIRST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 5.0
STEADY_S = 10.0
"""After a broker ran for this long, the pause before its restart is the shortest one again."""
ENDING_S = 3.0
"""How long Mosquitto may take to end after SIGTERM."""
_NO_PROCESS = (errno.EAGAIN, errno.ENOMEM)
"""The errors of a machine that has no room for a process at the moment."""
_NO_ADDRESS = (os.strerror(errno.EADDRINUSE), os.strerror(errno.EADDRNOTAVAIL))
"""The ends of Mosquitto's last line where its address is another program's, or not this machine's yet."""


class EmbeddedBroker:
    """One Mosquitto on `host:port`; with `files`, it is a broker of the fleet. `run` keeps it running until cancelled.

    `option` and `instead` are the command-line options that errors name: for its address, and for an external broker.
    `cuts`: it is restarted when a certificate is revoked whose name stays in use, to end that certificate's connection.
    """

    def __init__(
        self,
        host: str,
        port: int,
        program: str = mosquitto.PROGRAM,
        option: str = "--listen",
        instead: str = "--fog-broker",
        files: BrokerFiles | None = None,
        cuts: bool = True,
    ) -> None:
        self.host = host
        self.port = port
        self._files = files
        self._cuts = cuts
        self._scheme = "mqtt" if files is None else "mqtts"
        self._newest: RevocationList | None = None
        self._directory: Path | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._program = program
        self._option = option
        self._instead = instead
        self._has_run = False
        self._is_running = False
        self._owes_reload = False

    @property
    def url(self) -> str:
        """The URL by which the activator itself reaches the broker."""
        return f"{self._scheme}://{host_port(_OWN.get(self.host, self.host), self.port)}"

    def url_towards(self, host: str, port: int) -> str:
        """The URL by which others reach the broker; on all interfaces it has the address of the one towards `host`.

        Without a route to `host` it has this machine's name: a fog may start before its uplink.
        """
        if self.host not in _OWN:
            return self.url
        with socket.socket(socket.AF_INET6 if ":" in self.host else socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect((host, port))  # UDP: this only chooses the route
                name = str(probe.getsockname()[0])
            except OSError:
                name = socket.gethostname()
        return f"{self._scheme}://{host_port(name, self.port)}"

    async def run(self, waits: bool = False) -> None:
        """Start Mosquitto, and restart it when it ends; raises ConfigurationError if it cannot start.

        It cannot start if it exits without ever having run. One that ran, or was killed, is restarted however briefly
        it ran: that depends more on the machine than on Mosquitto. If the disk is full, failing or read-only, its
        files are written later. With `waits` it starts once its address is there and free.
        """
        program = mosquitto.find(self._program)
        if program is None:
            raise ConfigurationError(
                f"embedded broker: {self._program!r} is not installed; expected Mosquitto 2: {mosquitto.how_to_get()}; "
                f"or {self._instead} with a broker that runs elsewhere"
            )
        with contextlib.ExitStack() as left:
            await self._keep_running(program, await self._written(left), waits)

    async def _written(self, left: contextlib.ExitStack) -> Path:
        """Write the configuration into a folder that `left` removes; retried until the disk can be written."""
        has_told = False
        while True:
            try:
                return self._write(left)
            except (OSError, ConfigurationError) as error:
                cause = error.__cause__ if isinstance(error, ConfigurationError) else error
                if not isinstance(cause, OSError) or not (is_fault(cause) or self._directory is None):
                    raise
                if not has_told:
                    logger.error("embedded broker: %s; it starts once its files can be written", error)
                has_told = True
            left.close()
            self._directory = None
            await asyncio.sleep(LONGEST_PAUSE_S)

    def _write(self, left: contextlib.ExitStack) -> Path:
        made = tempfile.TemporaryDirectory(prefix="mqttxt-broker-", ignore_cleanup_errors=True)
        directory = self._directory = Path(left.enter_context(made))
        directory.chmod(0o755)
        if self._files is not None:
            return self._files.write(directory, self.host, self.port, self._newest)
        path = directory / "mosquitto.conf"
        path.write_text(mosquitto.configuration(self.host, self.port))
        path.chmod(0o644)
        return path

    def reload(self, newest: RevocationList | None = None) -> None:
        """Let Mosquitto read its access list and the revocation list anew; raises ConfigurationError for bad files.

        `newest` is this node's newest revocation list.
        """
        self._newest = newest
        if self._files is None or self._directory is None:
            return
        try:
            self._files.write_access(self._directory, newest)
        finally:
            outlived = self._files.take_outlived() if self._cuts else set()
            if not (outlived and self._kill(outlived)):
                self._owes_reload = self._files.is_list_readable
                self._signal()

    def _kill(self, names: set[str]) -> bool:
        """Kill Mosquitto, so that it is restarted: SIGHUP would end no connection. Returns whether it ran."""
        process = self._process
        if process is None or process.returncode is not None:
            return False
        logger.warning("embedded broker: a certificate of %s is revoked: it is started anew", ", ".join(sorted(names)))
        process.kill()
        return True

    def _signal(self) -> None:
        """Send a pending SIGHUP once Mosquitto runs; an earlier one would end it."""
        process = self._process
        if self._owes_reload and self._is_running and process is not None and process.returncode is None:
            self._owes_reload = False
            process.send_signal(signal.SIGHUP)

    async def _keep_running(self, program: str, configuration: Path, waits: bool) -> None:
        loop = asyncio.get_running_loop()
        has_told = False
        pause_s = FIRST_PAUSE_S
        while True:
            started = loop.time()
            try:
                code, last_line = await self._run_once(program, configuration)
                failure = f"ended with code {code} ({last_line})"
            except OSError as error:
                if not self._has_run and error.errno not in _NO_PROCESS:
                    raise
                code, failure = -1, f"cannot be started ({error.strerror or error})"
            lasted_s = loop.time() - started
            if code >= 0 and not self._has_run:
                where = f"{self._option} {host_port(self.host, self.port)}"
                if waits and last_line.endswith(_NO_ADDRESS):
                    if not has_told:
                        why = last_line.rpartition(": ")[2]
                        logger.error("%s: %s; the broker starts once it can listen there", where, why)
                    has_told = True
                    await asyncio.sleep(LONGEST_PAUSE_S)
                    continue
                if is_taken(self.host, self.port):
                    raise ConfigurationError(f"{where}: another program listens there; expected a free address")
                raise ConfigurationError(f"{where}: Mosquitto ended with code {code}: {last_line}")
            pause_s = FIRST_PAUSE_S if lasted_s >= STEADY_S else min(2 * pause_s, LONGEST_PAUSE_S)
            logger.warning("embedded broker %s; starting it again", failure)
            await asyncio.sleep(pause_s)

    async def _run_once(self, program: str, configuration: Path) -> tuple[int, str]:
        """Run Mosquitto to its end; returns its exit code and its last line of output."""
        self._is_running = False
        process = self._process = await asyncio.create_subprocess_exec(
            program,
            "-c",
            str(configuration),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            preexec_fn=ENDS_WITH_PARENT,
        )
        try:
            async with ending_with_parent(process.pid):
                return await self._followed(process)
        finally:
            if process.returncode is None:
                process.terminate()
                try:
                    async with asyncio.timeout(ENDING_S):
                        await process.wait()
                except TimeoutError:
                    process.kill()
                    await process.wait()

    async def _followed(self, process: asyncio.subprocess.Process) -> tuple[int, str]:
        last_line = ""
        assert process.stderr is not None
        async for line in process.stderr:
            last_line = line.decode(errors="replace").strip()
            if last_line.endswith(mosquitto.RUNNING):
                self._has_run = self._is_running = True
                self._signal()
            logger.debug("mosquitto: %s", last_line)
        return await process.wait(), last_line
