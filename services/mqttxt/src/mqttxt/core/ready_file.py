"""The file by which other programs see whether a role is ready."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ..errors import ConfigurationError
from ..security.files import is_folder


class ReadyFile:
    """A fresh modification time means ready; an old one, or no file, not ready.

    A failing disk does not end the role, and a slow one does not delay it: `count` is told of the failure. Raises
    ConfigurationError if the folder of the file does not exist.
    """

    def __init__(self, path: Path, count: Callable[[str, str], None]) -> None:
        if not is_folder(path.parent, f"--ready-file {path}"):
            raise ConfigurationError(f"--ready-file {path}: expected a file in a folder that exists")
        self._path = path
        self._count = count
        self._marking: asyncio.Future[None] | None = None
        self._is_closed = False

    def tell(self, is_ready: bool) -> None:
        """Touch the file, or remove it, unless the disk is still busy with the last time."""
        if not self._is_closed and (self._marking is None or self._marking.done()):
            self._marking = asyncio.create_task(self._mark(is_ready))

    async def close(self) -> None:
        """Remove the file for good."""
        self._is_closed = True
        if self._marking is not None:
            await self._marking
        await self._mark(False)

    async def _mark(self, is_ready: bool) -> None:
        try:
            await asyncio.to_thread(self._path.touch if is_ready else partial(self._path.unlink, missing_ok=True))
        except OSError as error:
            self._count("ready_file", f"{self._path}: {error.strerror or error}")
