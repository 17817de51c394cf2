"""The verdicts of the conformance kit on brokers, as Markdown tables for docs/brokers.md.

`python -m spec.brokers FILE` writes them between their markers, from the reports in the folder beside it that
`mqttxt conformance broker --format json` printed: docs/brokers/*.json for docs/brokers.md.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from mqttxt.errors import ConfigurationError
from mqttxt_conformance.broker import SIDES
from mqttxt_conformance.registry import RULES, Need, Rule, Verdict

from .pages import pages
from .tables import filled, table

_CELLS = {Verdict.PASS.value: "pass", Verdict.FAIL.value: "**fail**", Verdict.NOT_TESTED.value: "–"}


def reports(folder: Path) -> list[dict[str, Any]]:
    """The reports, in the order of their file names; raises ConfigurationError for one of a kit with other rules."""
    found = []
    for path in sorted(folder.glob("*.json")):
        report = json.loads(path.read_text(encoding="utf-8"))
        rules = [finding["rule"] for finding in report["findings"]]
        if rules != [rule.name for rule in RULES["broker"]]:
            raise ConfigurationError(f"{path}: its rules are not the kit's of now; run the kit again")
        found.append(report)
    return found


def rules_table() -> str:
    """Every rule, with its need on each side."""
    rows = [
        (f"`{rule.name}`", ", ".join(rule.numbers) or "–", rule.statement, *(rule.needs[side].value for side in SIDES))
        for rule in RULES["broker"]
    ]
    return table(("rule", "specification", "what is checked", *SIDES), rows)


def verdicts_table(found: list[dict[str, Any]]) -> str:
    """A row per rule that not every broker passes, a column per broker; last, for which sides each broker passes."""
    rows = []
    for index, rule in enumerate(RULES["broker"]):
        of_rule = [report["findings"][index] for report in found]
        if any(finding["verdict"] != Verdict.PASS.value for finding in of_rule):
            rows.append((f"`{rule.name}`", *map(_cell, of_rule)))
    passes = ["passes as the broker of", *(", ".join(_sides(report)) or "nobody" for report in found)]
    return table(("rule", *(report["name"] for report in found)), [*rows, passes])


def _cell(finding: dict[str, Any]) -> str:
    """A verdict; for a failure with its evidence."""
    evidence = f": {finding['evidence']}" if finding["verdict"] == Verdict.FAIL.value else ""
    return f"{_CELLS[finding['verdict']]}{evidence}"


def _sides(report: dict[str, Any]) -> list[str]:
    """The sides for which a broker failed no needed rule."""
    pairs: list[tuple[Rule, dict[str, Any]]] = list(zip(RULES["broker"], report["findings"], strict=True))
    failed = [rule for rule, finding in pairs if finding["verdict"] == Verdict.FAIL.value]
    return [side for side in SIDES if not any(rule.needs[side] is Need.NEEDED for rule in failed)]


def main(*files: str) -> None:
    """Write the tables into `files`."""
    for path in pages(files):
        found = reports(path.with_suffix(""))
        sections: dict[str, Callable[[], str]] = {
            "broker-rules": rules_table,
            "broker-verdicts": partial(verdicts_table, found),
        }
        path.write_text(filled(path.read_text(encoding="utf-8"), sections), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
