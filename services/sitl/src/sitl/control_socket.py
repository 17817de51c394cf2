"""The side channel's socket: one JSON object per line in, one per line out."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

from .errors import SitlError

Answer = Callable[[Any], Awaitable[dict[str, Any]]]
"""Takes a request and returns its answer; raises SitlError for a request that cannot be carried out."""


@contextlib.asynccontextmanager
async def served(path: Path, answer: Answer) -> AsyncIterator[None]:
    """Serve the socket while this is entered. Raises SitlError if it cannot be created."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.closing(writer), contextlib.suppress(ConnectionError):  # a client that disconnects is no error
            while line := await reader.readline():
                try:
                    found = await answer(json.loads(line))
                except (ValueError, SitlError) as error:
                    found = {"error": str(error)}
                writer.write(json.dumps(found).encode() + b"\n")
                await writer.drain()

    try:
        path.unlink(missing_ok=True)
        server = await asyncio.start_unix_server(serve, str(path))
    except OSError as error:
        raise SitlError(f"--control {path}: {error.strerror or error}") from error
    try:
        yield
    finally:
        server.close()
        path.unlink(missing_ok=True)
