"""The page about security: each attack in its tables names the tests that hold against it, and they are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.unit.mqttxt import test_attacks

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "security.md").read_text()
TESTS = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
ATTACKS = [
    [cell.strip() for cell in row.strip("| ").split(" | ")]
    for table in re.findall(r"^\| attack \| .*\n\| --- .*\n((?:\|.*\n)+)", PAGE, re.MULTILINE)
    for row in table.splitlines()
]


OF_OPEN_BROKERS = {f"test_attacks[{attack.__name__}]" for attack in test_attacks.ATTACKS}


def test_every_table_is_read() -> None:
    assert len(ATTACKS) >= 35


def test_each_attack_on_an_open_broker_has_a_row() -> None:
    assert {name for *_, tests in ATTACKS for name in re.findall(r"`(test_attacks\[.*?)`", tests)} == OF_OPEN_BROKERS


@pytest.mark.parametrize("row", ATTACKS, ids=lambda row: row[0][:60])
def test_each_attack_names_tests_that_are_there(row: list[str]) -> None:
    attack, holds, tests = row
    named = re.findall(r"`([^`]*)`", tests)
    assert attack
    assert holds
    assert named
    for pattern in set(named) - OF_OPEN_BROKERS:
        assert any(re.fullmatch(pattern.replace("*", ".*"), test) for test in TESTS), pattern
