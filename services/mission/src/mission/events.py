"""A mission's records: events.jsonl, and progress lines for whoever watches."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from mqttxt import Word

from .fleet import Reading

SHOW_LATER_S = 0.25
"""The delay of progress lines: showing one takes a core for milliseconds, which a step's command shall not lose."""


class EventLog:
    """One JSON object per line, with CLOCK_REALTIME in nanoseconds, as in packet captures."""

    def __init__(self, path: Path, progress: TextIO = sys.stdout) -> None:
        self._file = path.open("a", encoding="utf-8")
        self._progress = progress
        self._unshown: list[str] = []
        self._calls = 0

    def write(self, event: str, **detail: Any) -> None:
        record = {"t_ns": time.time_ns(), "event": event, **detail}
        self._file.write(json.dumps(record) + "\n")
        self._file.flush()

    def reading(self, fog: int, reading: Reading) -> None:
        """Log a sensor's value that has arrived."""
        self.write("reading", fog=fog, **asdict(reading))

    def outcome(
        self,
        call: int,
        command: str,
        fog: int,
        drone: int | None,
        word: Word,
        reason: str | None,
        command_id: str | None = None,
        settled: bool = False,
    ) -> None:
        """Log a word about a call; `settled`: it gives the outcome after an `unconfirmed`, and is no last word."""
        said = {"id": command_id, "word": word.label, "reason": reason, "final": word.is_last and not settled}
        self.write("outcome", call=call, command=command, fog=fog, drone=drone, **said)

    def next_call(self) -> int:
        """The number of a new API call, under which its retries and outcomes are logged."""
        self._calls += 1
        return self._calls

    def show(self, step: str, drones: dict[int, str]) -> None:
        """Write a progress line after SHOW_LATER_S: the time (CLOCK_MONOTONIC), the step, and each drone's status.

        Raises RuntimeError outside an event loop.
        """
        if not self._unshown:
            asyncio.get_running_loop().call_later(SHOW_LATER_S, self._show_all)
        where = {str(drone): text for drone, text in drones.items()}
        self._unshown.append(json.dumps({"at_s": time.monotonic(), "step": step, "drones": where}) + "\n")

    def close(self) -> None:
        self._show_all()
        self._file.close()

    def _show_all(self) -> None:
        self._progress.write("".join(self._unshown))
        self._progress.flush()
        self._unshown.clear()
