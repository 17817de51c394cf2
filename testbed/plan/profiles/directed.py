"""The directed links that are shaped, each with its states over time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from net.link_plan import EventPlan, LinkPlan

from ..topology import Topology
from .resolve import LinksPlan

SMALLEST_FRAME_BITS = 60 * 8
MOST_FRAMES_S = 100_000
"""The most frames per second that an unlimited link is expected to carry, as netem's limit must be a number."""
_SPARE_FRAMES = 1_000
WIDEST_JITTER = 4
"""netem's tables reach four deviations from the mean."""


@dataclass(frozen=True)
class Directed:
    """A directed link that is shaped: its number (mark and HTB class), ends, device and states.

    `is_open`: every stage exists, even without effect, so that figures can be set that were not planned.
    """

    name: str
    number: int
    source: str
    destination: str
    device: str
    states: tuple[tuple[float, LinkPlan, bool], ...]
    """(start in seconds, figures, whether it is closed), the first at 0."""
    is_open: bool = False

    @cached_property
    def has_rate(self) -> bool:
        return self.is_open or any(state.rate_bps is not None for _, state, _ in self.states)

    @cached_property
    def has_jitter(self) -> bool:
        return self.is_open or any(state.jitter_us for _, state, _ in self.states)

    @cached_property
    def has_corruption(self) -> bool:
        return self.is_open or any(state.corrupt for _, state, _ in self.states)

    @cached_property
    def limit(self) -> int:
        """The room for all frames that can be on the link at any time: without it a frame would be lost by mistake."""
        return max(frames_in_flight(state) for _, state, _ in self.states)

    @property
    def is_shared(self) -> bool:
        return self.states[0][1].shared_with is not None


def directed_links(plan: LinksPlan, topology: Topology, always: bool = False) -> list[Directed]:
    """The links that are shaped at any time, or with `always` all, with their numbers among all links."""
    found = []
    for number, name in enumerate(plan.links, 1):
        states = tuple(_states(plan, name))
        if not always and not any(state.is_shaped or closed for _, state, closed in states):
            continue
        kind, node, direction = name.split(":")
        device = f"{kind[:4]}-{node}-{direction}"
        found.append(Directed(name, number, *topology.ends[name], device, states, always))
    return found


def _states(plan: LinksPlan, name: str) -> Iterator[tuple[float, LinkPlan, bool]]:
    """A link's figures over time: later events override earlier ones for as long as they last."""
    base = asdict(plan.links[name])
    ahead = deque(event for event in plan.events if event.link == name)
    times = {0.0} | {event.at_s for event in ahead} | {_end_of(event) for event in ahead}
    lasting: list[EventPlan] = []
    last: tuple[LinkPlan, bool] | None = None
    for at_s in sorted(times):
        while ahead and ahead[0].at_s <= at_s:
            lasting.append(ahead.popleft())
        lasting = [event for event in lasting if at_s < _end_of(event)]
        figures: dict[str, Any] = dict(base)
        for event in lasting:
            figures |= event.change
        closed = bool(figures.pop("closed", False))
        state = (LinkPlan(**figures), closed)
        if state != last:
            yield at_s, *state
        last = state


def _end_of(event: EventPlan) -> float:
    return round(event.at_s + event.for_s, 6)


def frames_in_flight(state: LinkPlan) -> int:
    """The most frames that can be on a link at once, with some to spare."""
    frames_s = MOST_FRAMES_S if state.rate_bps is None else -(-state.rate_bps // SMALLEST_FRAME_BITS)
    longest_us = state.delay_us + WIDEST_JITTER * state.jitter_us
    return _SPARE_FRAMES + -(-min(frames_s, MOST_FRAMES_S) * longest_us // 1_000_000)
