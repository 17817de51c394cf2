"""The links of a run: shaped before any traffic, started with the mission, changed by profile, by hand and by range."""

from __future__ import annotations

import platform
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from socket import socket
from typing import Any, Protocol

from ..emulator.plan import PlanError, parse_change
from ..interfaces import NetError
from . import gates
from .choice import ShaperChoice
from .journal import HAND, RANGE, Journal, write_json
from .run_plan import RunPlan
from .server import Server

START_EVERY_S = 0.02
GATES_EVERY_S = 0.1
OTHERWISE_S = 1.0
FRESH_NS = 1_000_000_000
"""A start file that is younger than this when noticed sets the start by its own time, exact to a few milliseconds."""


class Links(Protocol):
    """A shaper of links. Every method raises NetError if the shaper fails."""

    @property
    def checked(self) -> Mapping[str, Any]: ...
    @property
    def socket(self) -> socket | None: ...
    def start(self, at_ns: int) -> None: ...
    def hold(self, link: str, change: Mapping[str, Any] | None, words: Sequence[Sequence[str]]) -> int: ...
    def shut(self, link: str, shut: bool) -> int: ...
    def attend(self) -> float | None: ...
    def end(self) -> None: ...


class Attendant:
    """Makes the chosen shaper and writes `shaper.json`; `attend` must be called again after the time it returns."""

    def __init__(
        self, folder: Path, run: RunPlan, choice: ShaperChoice, make: Callable[[Journal], Links | None]
    ) -> None:
        self._folder, self._run = folder, run
        self._start_file = folder / "start"
        if self._start_file.exists():
            raise NetError(f"{self._start_file}: is there before the mission; expected a folder of a fresh attempt")
        self._journal = Journal(folder / "events.jsonl")
        self._links = make(self._journal)
        self._server: Server | None = None
        self._started = False
        self._open: dict[str, bool] = {}
        checked: Mapping[str, Any] = {} if self._links is None else self._links.checked
        if self._links is None:
            write_json(folder / "counters.json", _nothing_counted(run))
        self._attend_gates()
        write_json(folder / "shaper.json", {**choice.to_data(), **_machine(), "checked": checked})

    def serve(self, path: Path) -> dict[socket, Callable[[], None]]:
        """Begin to accept changes by hand; returns the sockets to watch, each with its function to call if readable."""
        self._server = Server(path, self._answer)
        watched = {self._server.socket: self._server.serve}
        if self._links is not None and self._links.socket is not None:
            watched[self._links.socket] = self._note
        return watched

    def attend(self) -> float:
        """Check start file, gates and shaper; returns after how many seconds to call again. Raises NetError."""
        wanted = [OTHERWISE_S]
        if not self._started:
            self._look_for_start()
            wanted.append(OTHERWISE_S if self._started else START_EVERY_S)
        if self._run.gates:
            self._attend_gates()
            wanted.append(GATES_EVERY_S)
        if self._links is not None and (next_s := self._links.attend()) is not None:
            wanted.append(next_s)
        return min(wanted)

    def end(self) -> None:
        """Write the last counters and remove everything."""
        if self._links is not None:
            self._links.end()
        if self._server is not None:
            self._server.close()
        self._journal.close()

    def _note(self) -> None:
        if self._links is not None:
            self._links.attend()

    def _look_for_start(self) -> None:
        try:
            made_ns = self._start_file.stat().st_mtime_ns
        except FileNotFoundError:
            return
        now_ns = time.time_ns()
        at_ns = made_ns if now_ns - FRESH_NS < made_ns <= now_ns else now_ns
        self._started = True
        self._journal.started(at_ns)
        if self._links is not None:
            self._links.start(at_ns)

    def _attend_gates(self) -> None:
        for gate in self._run.gates:
            position = gates.read_position(gates.position_file(self._folder.parent, gate.drone))
            is_open = gates.is_open(gate, position)
            if self._links is not None and self._open.get(gate.link) != is_open:
                self._open[gate.link] = is_open
                for way in gate.ways:
                    at_ns = self._links.shut(way, not is_open)
                    self._journal.changed(at_ns, way, None if is_open else {"closed": True}, RANGE)

    def _answer(self, request: object) -> None:
        if not isinstance(request, dict) or not {"link", "change"} <= set(request) <= {"link", "change", "kernel"}:
            raise PlanError(f"{request!r}: expected an object with link, change and, with netem, kernel")
        link, change, words = request["link"], request["change"], request.get("kernel", [])
        if self._links is None:
            raise NetError(f"{link}: links are not shaped in this run; expected `always` in plan.json")
        if not isinstance(link, str) or link not in self._run.plan.links:
            raise PlanError(f"link {link!r}: expected one of {', '.join(self._run.plan.links)}")
        if change is not None:
            change = parse_change(self._run.plan.links, link, change, link)
        if not isinstance(words, list) or not all(_are_words(each) for each in words):
            raise PlanError(f"{link}: kernel: {words!r}: expected a list of lists of words, the first of each tc")
        at_ns = self._links.hold(link, change, words)
        self._journal.changed(at_ns, link, change, HAND)


def _are_words(value: object) -> bool:
    return isinstance(value, list) and value[:1] == ["tc"] and all(isinstance(word, str) for word in value)


def _nothing_counted(run: RunPlan) -> Mapping[str, Any]:
    nothing: Mapping[str, Any] = {"links": {}, "at_start": {}, "late_ms": None, "void": None}
    return {"version": 1, "shaper": "none", "profile": run.plan.profile, **nothing}


def _machine() -> Mapping[str, str]:
    shown = subprocess.run(["tc", "-Version"], capture_output=True, text=True, check=False)
    return {"kernel": platform.release(), "tc": shown.stdout.strip()}
