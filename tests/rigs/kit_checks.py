"""Checks of the conformance kit side by side: what one finds otherwise than expected is checked again by itself.

Rules measure times. Beside others, which keep the cores busy, an implementation may break one that it keeps alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mqttxt_conformance.registry import Finding, Verdict

MOST_AGAIN = 8
"""Implementations that are checked again. Where more are not as expected, it is not by what ran beside them."""


@dataclass(frozen=True)
class Expected:
    """The names of the rules that an implementation breaks; and of those not tested, None where that is left open."""

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
    """What the kit found of each implementation; of those checked again by themselves, what failed beside others."""

    found: dict[str, list[Finding]]
    beside_others: dict[str, str]


def check(
    find: Callable[[Path, Collection[str], int], dict[str, list[Finding]]],
    folder: Path,
    expected: Mapping[str, Expected],
    at_once: int,
) -> Checked:
    """Check implementations, so many at once, and again one by one those that are not as expected.

    `find` checks those named, so many at once, with a folder and brokers of their own.
    """
    found = find(folder / "together", expected.keys(), at_once)
    otherwise = [name for name, one in expected.items() if not one.is_met_by(found[name])]
    if not 0 < len(otherwise) <= MOST_AGAIN:
        return Checked(found, {})
    beside_others = {name: str(said(found[name], Verdict.FAIL)) for name in otherwise}
    return Checked({**found, **find(folder / "alone", otherwise, 1)}, beside_others)
