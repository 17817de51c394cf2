"""The autopilot's control socket, by which the message set puts the drone into a starting state without any link."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any, Self

from .fleet import MissionError

ANSWER_LIMIT_S = 400.0
"""A stand-in answers at once; a real autopilot first has to land, and to take off again."""


class SideChannel:
    """One drone's control socket, an async context manager. Raises MissionError if it does not answer."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def __aenter__(self) -> Self:
        try:
            self._streams = await asyncio.open_unix_connection(str(self._path))
        except OSError as error:
            raise MissionError(f"control socket {self._path}: {error.strerror or error}") from error
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._streams is not None:
            self._streams[1].close()

    async def set(self, **wanted: Any) -> dict[str, Any]:
        """Set fields of the drone's state; returns its true state afterwards. Raises MissionError."""
        assert self._streams is not None
        reader, writer = self._streams
        try:
            async with asyncio.timeout(ANSWER_LIMIT_S):
                writer.write(json.dumps({"set": wanted}).encode() + b"\n")
                await writer.drain()
                line = await reader.readline()
        except TimeoutError:
            raise MissionError(f"control socket {self._path}: no answer within {ANSWER_LIMIT_S:g} s") from None
        except OSError as error:
            raise MissionError(f"control socket {self._path}: {error.strerror or error}") from error
        if not line:
            raise MissionError(f"control socket {self._path}: the autopilot has ended")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise MissionError(f"control socket {self._path}: {answer['error']}")
        return answer
