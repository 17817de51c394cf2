"""The rules that the kit checks, each a small function with rule numbers of docs/protocol.md; and their execution."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

Check = Callable[[Any], Awaitable[str]]
"""Takes a role's kit; returns the evidence that the implementation keeps the rule, or raises Broken or NotTested."""


class Broken(Exception):
    """The implementation does not keep a rule; the text is the evidence."""


class NotTested(Exception):
    """A rule that could not be checked; the text says why."""


class Verdict(Enum):
    """The result of checking a rule."""

    PASS = "pass"
    FAIL = "fail"
    NOT_TESTED = "not tested"


class Need(Enum):
    """How far the protocol depends on a broker's rule: a broker passes if it keeps every NEEDED rule."""

    NEEDED = "needed"
    USEFUL = "useful"
    UNUSED = "not used"


@dataclass(frozen=True)
class Rule:
    """One rule to check: `numbers` are its rule numbers in docs/protocol.md, `statement` is its text in one line.

    `needs` is, for a broker's rule, its Need on each side (`cloud`, `fog`, `drone`).
    """

    role: str
    name: str
    numbers: tuple[str, ...]
    statement: str
    check: Check
    needs: Mapping[str, Need] = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """A rule's verdict and its evidence."""

    rule: Rule
    verdict: Verdict
    evidence: str


ROLES = (
    "uav", "uav with two connections", "uav over datagrams",
    "activator", "activator with two brokers", "activator over datagrams", "signed activator",
    "gs", "broker",
)  # fmt: skip
RULES: dict[str, list[Rule]] = {role: [] for role in ROLES}
"""Every rule of each role, in the order in which they are checked."""


def rule(role: str, *numbers: str, needs: Mapping[str, Need] | None = None) -> Callable[[Check], Check]:
    """Enter a check as a rule, with its name and, as the statement, the first line of its docstring."""

    def enter(check: Check) -> Check:
        statement = (check.__doc__ or "").strip().splitlines()[0]
        name = check.__name__.replace("_", "-")
        RULES[role].append(Rule(role, name, numbers, statement, check, needs or {}))
        return check

    return enter


def expect(condition: object, evidence: str) -> None:
    """Raises Broken with the evidence unless the condition holds."""
    if not condition:
        raise Broken(evidence)


async def check_all(rules: Iterable[Rule], kit: object, on_finding: Callable[[Finding], None]) -> list[Finding]:
    """Check one rule after the other; `on_finding` gets each finding at once."""
    found = []
    for one in rules:
        try:
            finding = Finding(one, Verdict.PASS, await one.check(kit))
        except Broken as broken:
            finding = Finding(one, Verdict.FAIL, str(broken))
        except NotTested as reason:
            finding = Finding(one, Verdict.NOT_TESTED, str(reason))
        found.append(finding)
        on_finding(finding)
    return found


async def check_met(
    meeting: Awaitable[object], failed: str, rules: Iterable[Rule], kit: object, on_finding: Callable[[Finding], None]
) -> list[Finding]:
    """Check the rules once `meeting` returns; if it raises Broken, `failed` fails and the others are not tested."""
    try:
        await meeting
    except Broken as broken:
        return unmet(rules, failed, str(broken), on_finding)
    return await check_all(rules, kit, on_finding)


def unmet(rules: Iterable[Rule], failed: str, evidence: str, on_finding: Callable[[Finding], None]) -> list[Finding]:
    """The findings for an implementation that never appeared: one rule fails, the others are not tested."""
    found = []
    for one in rules:
        is_it = one.name == failed
        verdict = Verdict.FAIL if is_it else Verdict.NOT_TESTED
        finding = Finding(one, verdict, evidence if is_it else f"the implementation did not appear: {failed}")
        found.append(finding)
        on_finding(finding)
    return found
