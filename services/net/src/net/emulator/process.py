"""From a plan to shaped links: checks it, binds the queues, directs the packets there, and shapes until the end.

Without a channel the links' clock begins at once. With one it waits for the order to start, and takes changes; see
control.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..ending import Ending
from ..hops import NodePair
from ..interfaces import NetError, Port
from . import counts, nfqueue, rules
from .control import Channel
from .network import Network, SettingsStep
from .nfqueue import Queues
from .plan import ShapedPlan
from .priority import raise_priority
from .shaper import Shaper
from .timing import Lateness


def shape(
    plan: ShapedPlan, ports: Sequence[Port], pairs: Sequence[NodePair], counters_file: Path, said: Path | Channel | None
) -> None:
    """Shape every link until SIGTERM or SIGINT; writes counters each second and at the end. Raises NetError.

    `said` is a file, made once all links are shaped, or a channel, which gets a message then and at every event.
    """
    ways = rules.ways_of(list(plan.links), ports, pairs)
    network = Network(plan)
    whole = queues_of_whole_packets(plan)
    channel = said if isinstance(said, Channel) else None
    queues = Queues(len(ways), whole)
    with contextlib.closing(queues), Ending() as ending:

        def tell(steps: Sequence[SettingsStep]) -> None:
            if channel is not None:
                channel.send({"events": [_event(step) for step in steps]})

        shaper = Shaper(network, ways, queues, whole, tell)
        writer = counts.Writer(counters_file)
        links = list(network.links.values())

        at_start: dict[str, Any] = {}

        def drops() -> dict[int, int]:
            return nfqueue.read_drops(nfqueue.COUNTS_FILE.read_text())

        def start(at_ns: int) -> None:
            network.start(at_ns)
            shaper.late = Lateness()  # lateness before the start only concerns calibration
            at_start.update(counts.by_link(links, drops()))

        def report() -> dict[str, Any]:
            late, held = shaper.late, shaper.held
            return counts.report(plan.profile, links, drops(), shaper.overruns, late, held, at_start or None)

        def tick() -> None:
            with _written("--counters", counters_file):
                writer.write(report())

        heard: dict[socket.socket, Callable[[], None]] = {ending.wake: ending.drain}
        if channel is not None:
            listener = _Listener(channel, network, shaper, queues, ways, ending, start)
            heard[channel.socket] = listener.hear
        else:
            start(0)
        rules.apply(ways)
        try:
            tick()
            if channel is not None:
                channel.send({"ready": {"queues": len(ways), "rules": len(ways) + 1, "urgency": raise_priority()}})
            elif isinstance(said, Path):
                with _written("--ready-file", said):
                    said.touch()
            shaper.run(heard, ending.has_come, tick)
        finally:
            with _written("--counters", counters_file):
                writer.finish(report())


def queues_of_whole_packets(plan: ShapedPlan) -> frozenset[int]:
    """The queues of links that corrupt or duplicate at any time, which need more than a packet's head."""
    touching = {name for name, link in plan.links.items() if link.corrupt or link.duplicate}
    touching |= {event.link for event in plan.events if event.change.get("corrupt") or event.change.get("duplicate")}
    return frozenset(queue for queue, name in enumerate(plan.links) if name in touching)


class _Listener:
    """Carries out the orders on the channel, and answers when each is done."""

    def __init__(
        self,
        channel: Channel,
        network: Network,
        shaper: Shaper,
        queues: Queues,
        ways: Sequence[rules.Way],
        ending: Ending,
        start: Callable[[int], None],
    ) -> None:
        self._start = start
        self._channel, self._network, self._shaper = channel, network, shaper
        self._queues, self._ways, self._ending = queues, ways, ending

    def hear(self) -> None:
        """Carry out all received orders; ends the process if the other end is gone."""
        while (order := self._channel.receive()) is not None:
            if not order:
                self._ending.end()
                return
            self._channel.send({"done": time.time_ns(), "events": self._do(order)})

    def _do(self, order: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Carry out an order; returns the profile's event that is in force again, if it ends a change by hand."""
        if "start_ns" in order:
            self._start(self._shaper.since_zero_ns(order["start_ns"]))
            return []
        name = order["link"]
        if "shut" in order:
            self._network.shut(name, order["shut"])
            return []
        if order["change"] is None:
            step = self._network.let_go(name)
            return [_event(step)] if step.change else []
        if order["change"].get("corrupt") or order["change"].get("duplicate"):
            queue = next(queue for queue, way in enumerate(self._ways) if way.link == name)
            self._shaper.copy_whole(self._queues, queue, self._ways[queue])
        self._network.hold(name, order["change"])
        return []


def _event(step: SettingsStep) -> dict[str, Any]:
    return {"t_ns": time.time_ns(), "link": step.link, "change": dict(step.change) or None}


@contextlib.contextmanager
def _written(option: str, path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NetError(f"{option} {path}: {error.strerror}; expected a file that can be written") from error
