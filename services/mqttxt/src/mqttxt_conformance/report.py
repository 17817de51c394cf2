"""Findings as a table for people and as JSON for machines."""

from __future__ import annotations

import json

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mqttxt.core.printable import printable

from .registry import Finding, Need, Verdict

_STYLES = {Verdict.PASS: "green", Verdict.FAIL: "bold red", Verdict.NOT_TESTED: "yellow"}


def as_json(role: str, findings: list[Finding], side: str | None = None, name: str | None = None) -> str:
    """`{"role", "pass", "fail", "not_tested", "findings": [{"rule", "numbers", "statement", …}]}`.

    For a broker also its `name`, the `side` that it was checked for, and each finding's `need`.
    """
    rows: list[dict[str, object]] = [
        {
            "rule": finding.rule.name,
            "numbers": list(finding.rule.numbers),
            "statement": finding.rule.statement,
            "verdict": finding.verdict.value,
            "evidence": finding.evidence,
        }
        for finding in findings
    ]
    counts = {verdict.value.replace(" ", "_"): count(findings, verdict) for verdict in Verdict}
    of_broker: dict[str, object] = {}
    if side is not None:
        of_broker = {"name": name, "side": side}
        for row, finding in zip(rows, findings, strict=True):
            row["need"] = finding.rule.needs[side].value
    return json.dumps({"role": role, **of_broker, **counts, "findings": rows}, indent=2)


def print_table(role: str, findings: list[Finding], console: Console, side: str | None = None) -> None:
    """Print one row per rule and the count of each verdict; for a broker also each rule's need on `side`."""
    shown = Table(title=f"Conformance of a {role}", title_justify="left", show_lines=True)
    for heading in ("rule", "verdict", *(("need",) if side is not None else ())):
        shown.add_column(heading, no_wrap=True)
    shown.add_column("evidence")
    for finding in findings:
        style = _STYLES[finding.verdict]
        name = f"{finding.rule.name}\n[dim]{', '.join(finding.rule.numbers)}[/]"
        need = (finding.rule.needs[side].value,) if side is not None else ()
        shown.add_row(name, f"[{style}]{finding.verdict.value}[/]", *need, _escaped(finding))
    console.print(shown)
    console.print(", ".join(f"{count(findings, verdict)} {verdict.value}" for verdict in Verdict))
    if side is not None:
        missing = [finding.rule.name for finding in failures(findings, side)]
        console.print(f"needed of a {side} broker, and missing: {', '.join(missing) or 'nothing'}")


def failures(findings: list[Finding], side: str | None = None) -> list[Finding]:
    """The findings with verdict FAIL; for a broker only those of rules that its side needs."""
    failed = [finding for finding in findings if finding.verdict is Verdict.FAIL]
    return [finding for finding in failed if side is None or finding.rule.needs[side] is Need.NEEDED]


def count(findings: list[Finding], verdict: Verdict) -> int:
    return sum(finding.verdict is verdict for finding in findings)


def _escaped(finding: Finding) -> str:
    return escape(f"{finding.rule.statement}\n{printable(finding.evidence)}")
