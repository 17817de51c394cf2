"""Findings as a table for people and as JSON for machines."""

from __future__ import annotations

import json

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mqttxt.core.printable import printable

from .registry import Finding, Verdict

_STYLES = {Verdict.PASS: "green", Verdict.FAIL: "bold red", Verdict.NOT_TESTED: "yellow"}


def as_json(role: str, findings: list[Finding]) -> str:
    """`{"role", "passed", "failed", "not_tested", "findings": [{"rule", "numbers", "statement", …}]}`."""
    rows = [
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
    return json.dumps({"role": role, **counts, "findings": rows}, indent=2)


def print_table(role: str, findings: list[Finding], console: Console) -> None:
    """One row a rule, and how many of each verdict."""
    shown = Table(title=f"Conformance of a {role}", title_justify="left", show_lines=True)
    shown.add_column("rule", no_wrap=True)
    shown.add_column("verdict", no_wrap=True)
    shown.add_column("evidence")
    for finding in findings:
        style = _STYLES[finding.verdict]
        name = f"{finding.rule.name}\n[dim]{', '.join(finding.rule.numbers)}[/]"
        shown.add_row(name, f"[{style}]{finding.verdict.value}[/]", _escaped(finding))
    console.print(shown)
    console.print(", ".join(f"{count(findings, verdict)} {verdict.value}" for verdict in Verdict))


def count(findings: list[Finding], verdict: Verdict) -> int:
    return sum(finding.verdict is verdict for finding in findings)


def _escaped(finding: Finding) -> str:
    return escape(f"{finding.rule.statement}\n{printable(finding.evidence)}")
