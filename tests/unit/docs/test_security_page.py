"""The page about security: each attack in its tables names the tests that hold against it, and they are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "security.md").read_text()
TESTS = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
ATTACKS = [
    [cell.strip() for cell in row.strip("| ").split(" | ")]
    for table in re.findall(r"^\| attack \| .*\n\| --- .*\n((?:\|.*\n)+)", PAGE, re.MULTILINE)
    for row in table.splitlines()
]


def test_both_tables_are_read() -> None:
    assert len(ATTACKS) >= 36


@pytest.mark.parametrize("row", ATTACKS, ids=lambda row: row[0][:60])
def test_each_attack_names_tests_that_are_there(row: list[str]) -> None:
    attack, holds, tests = row
    named = re.findall(r"`([^`]*)`", tests)
    assert attack
    assert holds
    assert named
    for pattern in named:
        assert any(re.fullmatch(pattern.replace("*", ".*"), test) for test in TESTS), pattern
