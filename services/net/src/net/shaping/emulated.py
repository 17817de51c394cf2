"""The emulator as a separate process, so that nothing else delays its packets."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..emulator.control import Channel
from ..emulator.plan import PlanError
from ..interfaces import NetError
from .journal import PROFILE, Journal

READY_S = 30.0
ANSWER_S = 5.0
END_S = 3.0
USAGE = 2
"""The emulator's exit code for a plan that cannot be carried out."""


class EmulatedLinks:
    """The emulator's process. Once constructed, every link is shaped. Raises NetError if that fails."""

    def __init__(self, folder: Path, journal: Journal) -> None:
        self._journal = journal
        self._channel, given = Channel.pair()
        files = ["--plan", str(folder / "plan.json"), "--counters", str(folder / "counters.json")]
        descriptor = given.socket.fileno()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "net", "shape", *files, "--channel", str(descriptor)],
            pass_fds=[descriptor],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        given.close()
        try:
            self.checked: Mapping[str, Any] = self._wait_for("ready", READY_S)
        except NetError:
            self.end()
            raise

    @property
    def socket(self) -> socket.socket:
        """Readable if the profile has changed a link, or the emulator has ended."""
        return self._channel.socket

    def attend(self) -> float | None:
        """Record the emulator's messages; it needs nothing else. Raises NetError if it has ended."""
        while (message := self._channel.receive()) is not None:
            self._note(message)
        return None

    def start(self, at_ns: int) -> None:
        """Start the links' clock at `at_ns` (unix time)."""
        self._order({"start_ns": at_ns})

    def hold(self, link: str, change: Mapping[str, Any] | None, words: Sequence[Sequence[str]]) -> int:
        """Apply a checked change by hand, None for back as planned; returns when it took effect (unix time)."""
        return self._order({"link": link, "change": None if change is None else dict(change)})

    def shut(self, link: str, shut: bool) -> int:
        """Let nothing through, or again what is planned; returns when that took effect (unix time)."""
        return self._order({"link": link, "shut": shut})

    def end(self) -> None:
        """End the emulator, which then writes its last counters. If it does not end, it is killed."""
        self._process.terminate()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._channel.close()

    def _order(self, order: Mapping[str, Any]) -> int:
        try:
            self._channel.send(order)
        except NetError:
            self._note({})
        done: int = self._wait_for("done", ANSWER_S)
        return done

    def _wait_for(self, key: str, limit_s: float) -> Any:
        self._channel.socket.settimeout(limit_s)
        try:
            while (message := self._channel.receive()) is not None:
                self._note(message)
                if key in message:
                    return message[key]
        finally:
            self._channel.socket.setblocking(False)
        raise NetError(f"the emulator has not answered for {limit_s:g} s; expected {key!r}")

    def _note(self, message: Mapping[str, Any]) -> None:
        if not message:
            raise self._last_words()
        for event in message.get("events", ()):
            self._journal.changed(event["t_ns"], event["link"], event["change"], PROFILE)

    def _last_words(self) -> NetError:
        _, said = self._process.communicate()
        lines = said.strip().splitlines() or [f"the emulator ended with exit code {self._process.returncode}"]
        kind = PlanError if self._process.returncode == USAGE else NetError
        return kind(lines[-1].removeprefix("net: "))
