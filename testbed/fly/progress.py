"""Progress on the terminal: a line per step, with the state of each drone."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

from rich.console import Console
from rich.status import Status
from rich.text import Text


class ConsoleProgress:
    """A live line for the current step on a terminal; elsewhere a line whenever the step changes."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status: Status | None = None
        self._step = ""
        self._step_started_s = self._at_s = 0.0
        self._drones: dict[str, str] = {}

    def attempt(self, protocol: str, number: int, of: int, repeat: int = 0) -> None:
        again = f", repeat {repeat}" if repeat else ""
        self._console.print(f"attempt {number} of {of} over {protocol}{again}")

    @contextlib.contextmanager
    def phase(self, text: str) -> Iterator[None]:
        """Print a phase and how long it took."""
        self._finish_step()
        started = time.monotonic()
        try:
            yield
        except BaseException:
            self._console.print(f"  {text} … failed")
            raise
        self._console.print(f"  {text} … {time.monotonic() - started:.1f} s")

    def step(self, name: str, drones: dict[str, str], at_s: float) -> None:
        """Update the current step, the state of each drone in it, and the time (seconds of any clock)."""
        self._at_s = at_s
        if name != self._step:
            self._finish_step()
            self._step, self._step_started_s = name, at_s
        self._drones = drones
        if self._console.is_terminal:
            if self._status is None:
                self._status = self._console.status("")
                self._status.start()
            self._status.update(Text(f"{name:<9} {self._where()}"))  # a step of an own mission has any name

    def ended(self, status: str, reason: str | None) -> None:
        self._finish_step()
        said = f"  {status}: {reason}" if reason else f"  {status}"
        self._console.print(said, soft_wrap=True, markup=False)  # a reason may have a container's log in it

    def _where(self) -> str:
        return " · ".join(f"{drone} {text}" for drone, text in self._drones.items())

    def _finish_step(self) -> None:
        """End the step: print how long it took and the state of each drone."""
        if self._status is not None:
            self._status.stop()
            self._status = None
        if self._step:
            took_s = self._at_s - self._step_started_s
            self._console.print(f"  {self._step:<9} {took_s:5.1f} s  {self._where()}", soft_wrap=True, markup=False)
        self._step = ""
