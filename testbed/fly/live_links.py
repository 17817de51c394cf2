"""Changes of a running fleet's links by hand: turns the typed options into a change for `net` per direction."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from net.link_plan import DIRECTIONS, LinkPlan

from ..errors import DockerError, UserError
from ..plan.profiles.checks import unfitting
from ..plan.profiles.kernel import change_words
from ..plan.profiles.reading import PARSERS, read_figure
from ..plan.profiles.resolve import LinksPlan
from ..plan.topology import Topology

PLAN_FILE = "/run-dir/links/plan.json"
Ask = Callable[[list[str]], str]
"""Runs a short command in `net` and returns what it prints."""


@dataclass(frozen=True)
class LiveChange:
    """The figures of one direction of a link from now on, in the plan's fields; None: as planned again."""

    link: str
    change: Mapping[str, Any] | None
    kernel: tuple[tuple[str, ...], ...]

    @property
    def command(self) -> list[str]:
        """The command to run in `net`."""
        fields = [f"{name}={json.dumps(value)}" for name, value in (self.change or {}).items()]
        return ["net", "change", self.link, *fields, "--kernel", json.dumps(self.kernel)]


def read_live_plan(ask: Ask) -> LinksPlan:
    """Read the plan of the links with which the running fleet was started. Raises DockerError if it cannot be read."""
    said = ask(["cat", PLAN_FILE])
    try:
        data = json.loads(said)["plan"]
        links = {name: LinkPlan(**figures) for name, figures in data["links"].items()}
        return LinksPlan(data["profile"], data["seed"], links, ())
    except (ValueError, KeyError, TypeError) as error:
        raise DockerError(f"net: {PLAN_FILE}: expected the plan of its links, found {said.strip()[:80]!r}") from error


def changes(
    plan: LinksPlan, topology: Topology, link: str, typed: Mapping[str, str], *, closed: bool, back: bool
) -> list[LiveChange]:
    """The changes that `testbed link` asks for, one for each direction that `link` names.

    `typed` has the given options, by their names in a profile. Other figures are as planned, whatever was changed by
    hand before. Raises UserError that names the option, its value and what was expected.
    """
    names = [name for name in plan.links if name == link or name.rpartition(":")[0] == link]
    if not names:
        known = dict.fromkeys(name.rpartition(":")[0] for name in plan.links)
        raise UserError(f"link {link}: expected one of {', '.join(known)}, with :up or :down for one direction of it")
    if back and (typed or closed):
        raise UserError("--back: expected no other option, because it restores the link's profile")
    if not (typed or closed or back):
        raise UserError(f"link {link}: expected what to change, as --loss 20%, --closed, or --back")
    figures = dict(read_figure(name, text, "by hand", f"--{name}") for name, text in typed.items())
    change = {name: figure.value for name, figure in figures.items()} | ({"closed": True} if closed else {})
    if "rate_bps" in change and change["rate_bps"] is None:
        change["queue_packets"] = None
    found = []
    for name in names:
        planned = plan.links[name]
        if "rate_bps" in change and planned.shared_with is not None and len(names) < len(DIRECTIONS):
            whole = name.rpartition(":")[0]
            raise UserError(f"--rate {typed['rate']}: expected the whole link, the directions of {whole} share a rate")
        state = replace(planned, **{field: value for field, value in change.items() if field != "closed"})
        _check(name, state, typed)
        words = change_words(plan, topology, name, state, closed=closed)
        found.append(LiveChange(name, None if back else change, words))
    return found


def tell(ask: Ask, wanted: LiveChange) -> None:
    """Have `net` apply a change. Raises DockerError with its reason if it refuses."""
    said = ask(wanted.command).strip()
    try:
        answer = json.loads(said)
    except ValueError:
        answer = {"error": said.splitlines()[-1] if said else "no answer"}
    if not answer.get("ok"):
        raise DockerError(f"{wanted.link}: {answer.get('error', said)}")


def _check(name: str, state: LinkPlan, typed: Mapping[str, str]) -> None:
    found = unfitting(asdict(state))
    if found is None:
        return
    field, expected = found
    option = next((option for option, (planned, _) in PARSERS.items() if planned == field), field)
    value = typed.get(option)
    raise UserError(f"{name}: --{option}{f' {value}' if value else ''}: expected {expected}")
