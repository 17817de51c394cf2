"""The kernel's part of `plan.json`: the first and last commands, and each link's states; @NODE is an interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..emulator.plan import is_number, mapping, wrong
from ..interfaces import Port
from .commands import Words
from .tallies import Place

PROGRAMS = ("ip", "tc")


@dataclass(frozen=True)
class State:
    """A link's state from `at_s` after the start on; `words` are the commands that set it from any other state."""

    at_s: float
    closed: bool
    words: tuple[Words, ...]


@dataclass(frozen=True)
class KernelLink:
    """A link's states, the first at 0, the commands that close it, and the place of its counters."""

    states: tuple[State, ...]
    shut: tuple[Words, ...]
    place: Place


@dataclass(frozen=True)
class KernelPlan:
    """The kernel's commands, with the names of interfaces filled in."""

    begin: tuple[Words, ...]
    end: tuple[Words, ...]
    links: Mapping[str, KernelLink]


def parse_kernel(data: object, ports: Sequence[Port], where: str) -> KernelPlan:
    """Parse the kernel's part. Raises PlanError that names field, value and what was expected."""
    top = mapping(data, where, ("begin", "timed", "end", "links"))
    names = {f"@{port.node}": port.interface for port in ports}
    begin = _commands(top.get("begin"), names, f"{where}.begin")
    outs = {(words[-1]): words for words in begin if "fw" in words}
    links = {
        name: _link(link, outs, f"{where}.links.{name}")
        for name, link in mapping(top.get("links"), f"{where}.links", None).items()
    }
    return KernelPlan(begin, _commands(top.get("end"), names, f"{where}.end"), links)


def _link(data: object, outs: Mapping[str, Words], where: str) -> KernelLink:
    given = mapping(data, where, ("device", "queue", "states", "shut"))
    device, queue, states = given.get("device"), given.get("queue"), given.get("states")
    if not isinstance(device, str) or device not in outs:
        raise wrong(f"{where}.device", device, "a device that a filter of begin leads to")
    if queue is not None and not isinstance(queue, str):
        raise wrong(f"{where}.queue", queue, "the handle of a netem, or null")
    if not isinstance(states, list) or not states:
        raise wrong(f"{where}.states", states, "a list with a first state")
    found = tuple(_state(state, f"{where}.states[{number}]") for number, state in enumerate(states))
    leads = outs[device]
    place = Place(device, hex(int(leads[leads.index("handle") + 1])), leads[leads.index("dev") + 1], queue)
    return KernelLink(found, _commands(given.get("shut"), {}, f"{where}.shut"), place)


def _state(data: object, where: str) -> State:
    given: Mapping[str, Any] = mapping(data, where, ("at_s", "closed", "words"))
    if not is_number(given.get("at_s")):
        raise wrong(f"{where}.at_s", given.get("at_s"), "seconds since the start")
    if not isinstance(given.get("closed"), bool):
        raise wrong(f"{where}.closed", given.get("closed"), "true or false")
    return State(float(given["at_s"]), given["closed"], _commands(given.get("words"), {}, f"{where}.words"))


def _commands(value: object, names: Mapping[str, str], where: str) -> tuple[Words, ...]:
    if not isinstance(value, list):
        raise wrong(where, value, "a list of commands")
    found = []
    for number, words in enumerate(value):
        if not isinstance(words, list) or not all(isinstance(word, str) for word in words) or not words:
            raise wrong(f"{where}[{number}]", words, "a command as a list of words")
        if words[0] not in PROGRAMS:
            raise wrong(f"{where}[{number}]", words[0], f"one of {', '.join(PROGRAMS)}")
        unknown = [word for word in words if word.startswith("@") and word not in names]
        if unknown:
            raise wrong(f"{where}[{number}]", unknown[0], f"one of {', '.join(names) or 'no interface here'}")
        found.append([names.get(word, word) for word in words])
    return tuple(found)
