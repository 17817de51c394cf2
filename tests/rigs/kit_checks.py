"""Parallel checks of the conformance kit: an implementation with an unexpected result is checked again alone.

Rules measure times. Beside others that keep the cores busy, an implementation may break a rule that it keeps alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mqttxt_conformance.registry import Finding, Verdict
from tests.rigs.processes import Program

MOST_AGAIN = 8
"""The most implementations that are checked again. If more are not as expected, load is not the cause."""


@dataclass(frozen=True)
class Expected:
    """The names of the rules that an implementation breaks, and of those not tested, None if that is left open."""

    fail: set[str]
    not_tested: set[str] | None = None

    def is_met_by(self, found: Iterable[Finding]) -> bool:
        left = set(said(found, Verdict.NOT_TESTED))
        return set(said(found, Verdict.FAIL)) == self.fail and self.not_tested in (None, left)


def said(found: Iterable[Finding], verdict: Verdict) -> dict[str, str]:
    """The evidence of each rule that has this verdict."""
    return {finding.rule.name: finding.evidence for finding in found if finding.verdict is verdict}


@dataclass(frozen=True)
class Checked:
    """The kit's findings by implementation, and for those checked again alone what had failed beside others."""

    found: dict[str, list[Finding]]
    beside_others: dict[str, str]


class Checks(Protocol):
    """Checks of implementations at brokers of their own."""

    @property
    def brokers(self) -> Sequence[Program]: ...

    @property
    def found(self) -> dict[str, list[Finding]]: ...

    async def run(self) -> None: ...


Find = Callable[[Path, Collection[str], int], dict[str, list[Finding]]]
"""Checks the named implementations with a folder and brokers of their own; last, how many in parallel."""


def finder(make: Callable[[Path, Collection[str], int], Checks]) -> Find:
    def found(folder: Path, names: Collection[str], at_once: int) -> dict[str, list[Finding]]:
        folder.mkdir()
        made = make(folder, names, at_once)
        with ExitStack() as stack:
            for broker in made.brokers:
                stack.callback(broker.start().kill)
            asyncio.run(made.run())
        return made.found

    return found


def check(
    find: Find,
    folder: Path,
    expected: Mapping[str, Expected],
    at_once: int,
) -> Checked:
    """Check implementations, `at_once` in parallel; check again one by one those that are not as expected."""
    found = find(folder / "together", expected.keys(), at_once)
    otherwise = [name for name, one in expected.items() if not one.is_met_by(found[name])]
    if not 0 < len(otherwise) <= MOST_AGAIN:
        return Checked(found, {})
    beside_others = {name: str(said(found[name], Verdict.FAIL)) for name in otherwise}
    return Checked({**found, **find(folder / "alone", otherwise, 1)}, beside_others)
