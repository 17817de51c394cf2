"""docs/brokers.md tells what the conformance kit found, and each side's needs decide who passes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mqttxt.errors import ConfigurationError
from mqttxt_conformance.registry import RULES, Need
from spec import brokers

PAGE = Path(__file__).parents[3] / "docs" / "brokers.md"


def test_the_tables_are_made_from_the_kits_reports(tmp_path: Path) -> None:
    copy = tmp_path / PAGE.name
    copy.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    copy.with_suffix("").symlink_to(PAGE.with_suffix(""))
    brokers.main(str(copy))
    assert copy.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8"), "run make docs"


def test_a_report_of_an_older_kit_is_named(tmp_path: Path) -> None:
    (tmp_path / "old.json").write_text(json.dumps({"findings": [{"rule": "carries-doves"}]}))
    with pytest.raises(ConfigurationError, match=r"old\.json: its rules are not the kit's of now; run the kit again"):
        brokers.reports(tmp_path)


def test_what_is_needed_alone_decides_for_which_sides_a_broker_serves() -> None:
    for rule in RULES["broker"]:
        findings = [{"rule": one.name, "verdict": "fail" if one is rule else "pass"} for one in RULES["broker"]]
        missing = {side for side, need in rule.needs.items() if need is Need.NEEDED}
        assert set(brokers._sides({"findings": findings})) == {"cloud", "fog", "drone"} - missing


def test_every_rule_says_how_much_it_is_needed_and_one_that_is_used_names_its_numbers() -> None:
    for rule in RULES["broker"]:
        assert set(rule.needs) == {"cloud", "fog", "drone"}, rule.name
        assert bool(rule.numbers) == (set(rule.needs.values()) != {Need.UNUSED}), rule.name
