"""The implementation under test as a process of the kit's own, where a command line for it was given."""

from __future__ import annotations

import asyncio
import contextlib
import shlex
from pathlib import Path

from mqttxt.errors import ConfigurationError

from .registry import NotTested

END_S = 10.0


class Subject:
    """Starts and ends one command line, as often as rules need it; without one, rules that do are not tested."""

    def __init__(self, command_line: str | None, values: dict[str, str], log: Path | None = None) -> None:
        self._arguments: list[str] = []
        self._process: asyncio.subprocess.Process | None = None
        self._log = log
        if command_line is None:
            return
        try:
            parts = shlex.split(command_line)
            self._arguments = [part.format(**values) for part in parts]
        except (ValueError, KeyError, IndexError) as error:
            known = ", ".join("{" + name + "}" for name in values)
            raise ConfigurationError(
                f"--run {command_line!r}: {error}; expected a command line, with {known}"
            ) from None
        if not self._arguments:
            raise ConfigurationError("--run '': expected a command line")

    @property
    def is_ours(self) -> bool:
        """Whether the kit can start and end the implementation."""
        return bool(self._arguments)

    @property
    def exit_code(self) -> int | None:
        return self._process.returncode if self._process is not None else None

    async def start(self) -> None:
        """Raises ConfigurationError where the program cannot be started."""
        output = self._log.open("ab") if self._log is not None else None
        try:
            sink = output or asyncio.subprocess.DEVNULL
            self._process = await asyncio.create_subprocess_exec(
                *self._arguments, stdin=asyncio.subprocess.DEVNULL, stdout=sink, stderr=sink
            )
        except OSError as error:
            raise ConfigurationError(f"--run {self._arguments[0]!r}: {error.strerror or error}") from error
        finally:
            if output is not None:
                output.close()

    def need(self) -> None:
        """Raises NotTested where the kit cannot start the implementation."""
        if not self.is_ours:
            raise NotTested("needs --run, so that the kit can start and end the implementation")

    async def ended(self, limit_s: float = END_S) -> int | None:
        """The exit code once it has ended, None where it goes on."""
        assert self._process is not None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(limit_s):
                await self._process.wait()
        return self._process.returncode

    def terminate(self) -> None:
        """SIGTERM: a clean stop."""
        if self._process is not None and self._process.returncode is None:
            self._process.terminate()

    async def kill(self) -> None:
        """SIGKILL: as a crash would end it."""
        if self._process is not None and self._process.returncode is None:
            self._process.kill()
            await self._process.wait()
