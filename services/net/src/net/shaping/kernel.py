"""Links shaped by netem: runs the plan's first commands and reads them back, then the others at their times.

Every change is one process of `tc`, which first shows the link's counters. So drops by a closed link are told from
random loss.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..emulator.network import steps
from ..emulator.plan import PlanError
from ..interfaces import NetError, Port
from .commands import Runner, Words, carry_out, run
from .journal import PROFILE, Journal, write_json
from .kernel_plan import KernelPlan, State, parse_kernel
from .readback import read_back
from .run_plan import RunPlan
from .tallies import Tallies

COUNT_EVERY_S = 1.0
_US = 1_000_000


class KernelLinks:
    """netem's links. Once constructed, every link is shaped and read back. Raises NetError if that fails."""

    socket = None
    """There is no socket to watch: `attend` returns when it must be called again."""

    def __init__(
        self, folder: Path, run_plan: RunPlan, ports: Sequence[Port], journal: Journal, runner: Runner = run
    ) -> None:
        self._file, self._journal, self._runner = folder / "counters.json", journal, runner
        self._profile = run_plan.plan.profile
        where = f"{folder / 'plan.json'}: kernel"
        self._plan: KernelPlan = parse_kernel(run_plan.kernel, ports, where)
        missing = [name for name in run_plan.plan.links if name not in self._plan.links]
        if run_plan.always and missing:
            raise PlanError(f"{where}.links: none of {missing[0]}; expected all, as always says")
        self._changes = {(step.link, round(step.at_ns / 1000)): step.change for step in steps(run_plan.plan)}
        links = self._plan.links.items()
        self._state = {name: link.states[0] for name, link in links}
        self._ahead = [(state.at_s, name, state) for name, link in links for state in link.states[1:]]
        self._ahead.sort(key=lambda each: each[0], reverse=True)
        self._held: dict[str, State] = {}
        self._shut: set[str] = set()
        self._told = {_object(words): words[3:] for words in self._plan.begin}
        self._tallies = Tallies({name: link.place for name, link in links})
        for name, state in self._state.items():
            self._tallies.links[name].closed = state.closed
        self._start_s: float | None = None
        self._at_start: Mapping[str, Any] | None = None
        self._count_s = 0.0
        carry_out(self._plan.begin, runner, "kernel.begin")
        self.checked: Mapping[str, Any] = read_back(self._plan.begin, runner)
        self._count()

    def start(self, at_ns: int) -> None:
        """Start the links' clock at `at_ns` (unix time)."""
        self._start_s = time.monotonic() - (time.time_ns() - at_ns) / 1e9
        self._tallies.read(carry_out(self._tallies.shows(), self._runner, "count"))
        self._at_start = self._tallies.by_link()

    def attend(self) -> float | None:
        """Make the changes that are due, and count once per second; returns after how many seconds to call again."""
        if self._start_s is not None:
            self._keep_up(time.monotonic() - self._start_s)
        if time.monotonic() >= self._count_s:
            self._count()
        wanted_s = self._count_s
        if self._start_s is not None and self._ahead:
            wanted_s = min(wanted_s, self._start_s + self._ahead[-1][0])
        return max(0.0, wanted_s - time.monotonic())

    def hold(self, link: str, change: Mapping[str, Any] | None, words: Sequence[Words]) -> int:
        """Apply a checked change by hand, None for back as planned; returns when it took effect (unix time)."""
        self._check(link)
        before = dict(self._held)
        if change is None:
            self._held.pop(link, None)
        elif not words:
            raise PlanError(f"{link}: kernel: []: expected the commands for it, since netem shapes")
        else:
            self._held[link] = State(0.0, bool(change.get("closed")), tuple(words))
        try:
            at_ns = self._bring([link])
        except NetError:
            self._held = before
            raise
        if change is None and (planned := self._change_of(link)):
            self._journal.changed(at_ns, link, planned, PROFILE)
        return at_ns

    def shut(self, link: str, shut: bool) -> int:
        """Let nothing through, or again what is planned; returns when that took effect (unix time)."""
        self._check(link)
        (self._shut.add if shut else self._shut.discard)(link)
        return self._bring([link])

    def end(self) -> None:
        """Count for the last time and remove everything."""
        self._count()
        carry_out(self._plan.end, self._runner, "kernel.end")

    def _check(self, link: str) -> None:
        if link not in self._plan.links:
            raise NetError(f"{link}: has no stages in this run; expected `always` in plan.json")

    def _keep_up(self, now_s: float) -> None:
        due: dict[str, None] = {}
        while self._ahead and self._ahead[-1][0] <= now_s:
            _, name, self._state[name] = self._ahead.pop()
            due[name] = None
        names = [name for name in due if name not in self._held]
        if names:
            at_ns = self._bring(names)
            for name in names:
                self._journal.changed(at_ns, name, self._change_of(name) or None, PROFILE)

    def _change_of(self, link: str) -> Mapping[str, Any]:
        """The link's figures that its events set now."""
        return self._changes.get((link, round(self._state[link].at_s * _US)), {})

    def _bring(self, names: Sequence[str]) -> int:
        """Bring each link to its current state; returns when that was done (unix time)."""
        commands: list[Words] = []
        for name in names:
            commands.append(["tc", "qdisc", "show", "dev", self._plan.links[name].place.device])
            commands += [words for words in self._words_of(name) if self._told.get(_object(words)) != words[3:]]
        shown = carry_out(commands, self._runner, "change")
        at_ns = time.time_ns()
        self._told |= {_object(words): words[3:] for words in commands}
        for name, content in zip(names, shown, strict=True):
            self._tallies.read_qdiscs(content, self._plan.links[name].place.device)
            held = self._held.get(name, self._state[name])
            self._tallies.links[name].closed = name in self._shut or held.closed
        return at_ns

    def _words_of(self, name: str) -> Sequence[Words]:
        if name in self._shut:
            return self._plan.links[name].shut
        return self._held.get(name, self._state[name]).words

    def _count(self) -> None:
        self._count_s = time.monotonic() + COUNT_EVERY_S
        self._tallies.read(carry_out(self._tallies.shows(), self._runner, "count"))
        (devices,) = carry_out([["ip", "link", "show", "type", "ifb"]], self._runner, "count")
        lost = {device["ifname"]: _dropped(device) for device in devices if _dropped(device)}
        void = f"the kernel dropped frames before the links: {lost}" if lost else None
        write_json(self._file, self._tallies.report(self._profile, void, self._at_start), indent=None)


def _object(words: Words) -> tuple[str, ...]:
    """The object that a command makes or changes: its words up to the figures."""
    ends = [place for place, word in enumerate(words) if word in ("netem", "htb", "action")]
    return (words[0], words[1], *words[3 : ends[0] if ends else len(words)])


def _dropped(device: Mapping[str, Any]) -> int:
    counted = device.get("stats64", {})
    return sum(int(counted.get(way, {}).get("dropped", 0)) for way in ("rx", "tx"))
