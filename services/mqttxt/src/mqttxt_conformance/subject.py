"""The implementation under test as a child process of the kit, if a command line for it is given."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
import signal
import string
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from mqttxt.core.printable import printable
from mqttxt.errors import ConfigurationError

from .registry import NotTested

END_S = 10.0
_TAIL = 4096
_LONGEST_LINE = 300


class Subject:
    """Starts and ends the command line as often as rules need it; without one, rules that need it are not tested."""

    def __init__(self, command_line: str | None, values: dict[str, str], log: Path | None = None) -> None:
        self._parts: list[str] = []
        self._values = values
        self._process: asyncio.subprocess.Process | None = None
        self._output = log
        """The file that gets its stderr, and with a log its stdout too; its newest run begins at byte `_from_byte`."""
        self._from_byte = 0
        self._unlogged: IO[bytes] | None = None
        """The temporary file used without a log, deleted when the kit ends."""
        if command_line is None:
            return
        try:
            self._parts = shlex.split(command_line)
            self._check_names()
        except ValueError as error:
            known = ", ".join("{" + name + "}" for name in values)
            raise ConfigurationError(
                f"--run {command_line!r}: {error}; expected a command line, with {known}"
            ) from None
        if not self._parts:
            raise ConfigurationError("--run '': expected a command line")

    @property
    def is_ours(self) -> bool:
        """Whether the kit can start and end the implementation."""
        return bool(self._parts)

    def names(self, value: str) -> bool:
        """Whether the command line has a value's name in braces."""
        return any("{" + value + "}" in part for part in self._parts)

    @property
    def exit_code(self) -> int | None:
        return self._process.returncode if self._process is not None else None

    @property
    def ending(self) -> str:
        """How it ended, as `exit code 2: LINE` with the last line of its stderr, or with a log of that log."""
        line = self._last_line()
        return f"exit code {self.exit_code}{f': {line}' if line else ''}"

    def why_silent(self, waited: str) -> str:
        """The reason why it has not appeared: it has ended, or `waited` went by."""
        return f"it ended with {self.ending}" if self.exit_code is not None else f"{waited} went by"

    def _last_line(self) -> str:
        """Its last line of output; empty without output since its start, or if the log is no regular file."""
        if self._output is None or not self._output.is_file():
            return ""
        with self._output.open("rb") as output:
            end = output.seek(0, os.SEEK_END)
            output.seek(max(self._from_byte, end - _TAIL))
            lines = output.read().decode(errors="replace").split("\n")
        return next((printable(line.strip())[:_LONGEST_LINE] for line in reversed(lines) if line.strip()), "")

    def _check_names(self) -> None:
        """Raises ValueError if braces contain anything but a value's name: `format` would look it up in Python."""
        for part in self._parts:
            for _, name, width, conversion in string.Formatter().parse(part):
                if name is not None and (name not in self._values or width or conversion):
                    raise ValueError(f"{name!r} in braces")

    def _arguments(self, **changed: str) -> list[str]:
        return [part.format(**{**self._values, **changed}) for part in self._parts]

    async def start(self, **changed: str) -> None:
        """Start the command line, with `changed` values; raises ConfigurationError if the program cannot be started."""
        arguments = self._arguments(**changed)
        if self._output is None:
            self._unlogged = tempfile.NamedTemporaryFile(prefix="mqttxt-conformance-")  # noqa: SIM115
            self._output = Path(self._unlogged.name)
        with self._output.open("ab") as output:
            self._from_byte = os.fstat(output.fileno()).st_size
            try:
                self._process = await asyncio.create_subprocess_exec(
                    *arguments,
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=output if self._unlogged is None else asyncio.subprocess.DEVNULL,
                    stderr=output,
                )
            except OSError as error:
                raise ConfigurationError(f"--run {arguments[0]!r}: {error.strerror or error}") from error

    def need(self) -> None:
        """Raises NotTested if the kit cannot start the implementation."""
        if not self.is_ours:
            raise NotTested("needs --run, so that the kit can start and end the implementation")

    async def ended(self, limit_s: float = END_S) -> int | None:
        """Wait for its end; returns the exit code, None if it still runs."""
        assert self._process is not None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(limit_s):
                await self._process.wait()
        return self._process.returncode

    @contextlib.contextmanager
    def stopped(self) -> Iterator[None]:
        """Let it stand still, by SIGSTOP and SIGCONT."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)

    def terminate(self) -> None:
        """Send SIGTERM: a clean stop."""
        if self._process is not None and self._process.returncode is None:
            self._process.terminate()

    async def kill(self) -> None:
        """Send SIGKILL and wait for the end: as after a crash."""
        if self._process is not None and self._process.returncode is None:
            self._process.kill()
            await self._process.wait()
