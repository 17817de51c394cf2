"""From a plan to shaped links: checks it, binds the queues, leads the packets there, and shapes until the end."""

from __future__ import annotations

import contextlib
import signal
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..hops import Link as Pair
from ..interfaces import NetError, Port
from . import counts, nfqueue, rules
from .network import Network
from .nfqueue import Queues
from .plan import Plan
from .shaper import Shaper


def shape(plan: Plan, ports: Sequence[Port], pairs: Sequence[Pair], counters_file: Path, ready_file: Path) -> None:
    """Shape every link until SIGTERM or SIGINT, with counters written each second and at the end. Raises NetError."""
    ways = rules.ways_of(list(plan.links), ports, pairs)
    network = Network(plan)
    whole = queues_of_whole_packets(plan)
    queues = Queues(len(ways), whole)
    with contextlib.closing(queues), _Ending() as ending:
        shaper = Shaper(network, ways, queues, whole)
        writer = counts.Writer(counters_file)
        links = list(network.links.values())

        def report() -> dict[str, Any]:
            drops = nfqueue.read_drops(nfqueue.COUNTS_FILE.read_text())
            return counts.report(plan.profile, links, drops, shaper.overruns, shaper.late, shaper.held)

        def tick() -> None:
            with _written("--counters", counters_file):
                writer.write(report())

        rules.apply(ways)
        try:
            tick()
            with _written("--ready-file", ready_file):
                ready_file.touch()
            shaper.run(ending.wake, ending.has_come, tick)
        finally:
            with _written("--counters", counters_file):
                writer.finish(report())


def queues_of_whole_packets(plan: Plan) -> frozenset[int]:
    """The places of links that corrupt or duplicate at any time, for which a packet's head is not enough."""
    touching = {name for name, link in plan.links.items() if link.settings.corrupt or link.settings.duplicate}
    touching |= {event.link for event in plan.events if event.change.get("corrupt") or event.change.get("duplicate")}
    return frozenset(queue for queue, name in enumerate(plan.links) if name in touching)


@contextlib.contextmanager
def _written(option: str, path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NetError(f"{option} {path}: {error.strerror}; expected a file that can be written") from error


class _Ending:
    """SIGTERM and SIGINT, as a socket that becomes readable: a signal wakes whoever waits for packets."""

    def __enter__(self) -> _Ending:
        self._come = False
        self.wake, self._other = socket.socketpair()
        self._other.setblocking(False)
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGTERM, signal.SIGINT)}
        self._descriptor = signal.set_wakeup_fd(self._other.fileno())
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._descriptor)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self.wake.close()
        self._other.close()

    def has_come(self) -> bool:
        return self._come

    def _note(self, *_: object) -> None:
        self._come = True
