"""The headline table: what it asks for, and each mistake in it as one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from testbed.errors import UserError
from testbed.numbers.reproduction import JUDGED
from testbed.plan.documents import read_document
from testbed.plan.experiments import ARMS, EXPERIMENTS, MESSAGES, PROTOCOLS
from testbed.plan.headline import HEADLINE, SCHEMA_FILE, read_headline

LINE = {"quantity": "size_bytes", "of": "ratio", "expected": 2, "margin": [1, 3], "reason": "a guess"}
CELL: dict[str, Any] = {"experiment": "scenario-1", "arm": "thesis", "profile": "ideal", "lines": [LINE]}
TABLE: dict[str, Any] = {"attempts": 5, "seed": 7, "cells": [CELL]}


def _read(folder: Path, table: Any, **options: str) -> Any:
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump(table))
    return read_headline(path, **options)


def test_the_projects_own_table_is_flown_with_both_protocols_at_least_five_times() -> None:
    headline = read_headline()
    assert headline.attempts >= 5
    assert all(set(cell.plan.protocols) == set(PROTOCOLS) for cell in headline.cells)
    assert {cell.plan.attempts for cell in headline.cells} == {headline.attempts}
    assert {cell.plan.order_seed for cell in headline.cells} == {headline.seed}


def test_what_the_schema_offers_is_what_there_is() -> None:
    schema = yaml.safe_load(SCHEMA_FILE.read_text())["$defs"]
    cell, line = schema["cell"]["properties"], schema["line"]["properties"]
    assert cell["experiment"]["enum"] == [name for name in EXPERIMENTS if name != MESSAGES]
    assert cell["arm"]["enum"] == list(ARMS)
    assert set(line["quantity"]["enum"]) <= set(JUDGED)
    assert line["of"]["enum"] == ["ratio", *PROTOCOLS]
    for field in (cell["experiment"], cell["arm"], line["quantity"]):
        assert field["description"] == f"one of {', '.join(field['enum'])}"


def test_every_margin_has_its_reason_and_the_published_figure_inside() -> None:
    document = read_document(HEADLINE, SCHEMA_FILE)
    for line in (line for cell in document["cells"] for line in cell["lines"]):
        assert line["margin"][0] <= line["expected"] <= line["margin"][1]
        assert len(line["reason"].split()) > 3


def test_attempts_and_seed_can_be_others(tmp_path: Path) -> None:
    headline = _read(tmp_path, TABLE, attempts="3", seed="11")
    assert (headline.attempts, headline.seed) == (3, 11)
    assert (headline.cells[0].plan.attempts, headline.cells[0].plan.order_seed) == (3, 11)


def test_who_flies_first_is_drawn_from_the_seed_and_the_same_again(tmp_path: Path) -> None:
    plan, again = (_read(tmp_path, TABLE).cells[0].plan for _ in range(2))
    orders = [plan.order(number) for number in range(1, 21)]
    assert orders == [again.order(number) for number in range(1, 21)]
    assert {first for first, _ in orders} == set(PROTOCOLS)
    assert all(set(order) == set(PROTOCOLS) for order in orders)
    other = _read(tmp_path, TABLE, seed="8").cells[0].plan
    assert orders != [other.order(number) for number in range(1, 21)]


def _changed(line: dict[str, Any] | None = None, cell: dict[str, Any] | None = None, **table: Any) -> dict[str, Any]:
    return TABLE | {"cells": [CELL | {"lines": [LINE | (line or {})]} | (cell or {})]} | table


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (_changed(attempts=2), "attempts: 2: expected how often each cell is flown"),
        (_changed(seed=-1), "seed: -1: expected a whole number from 0 on"),
        (_changed(cells=[]), "cells: []: expected a list of at least one experiment"),
        (
            _changed(cell={"experiment": "scenario-9"}),
            "cells[0].experiment: 'scenario-9': expected one of scenario-1, ",
        ),
        (_changed(cell={"arm": "best"}), "cells[0].arm: 'best': expected one of thesis, "),
        (_changed(cell={"profile": "moon"}), "cells[0].profile: 'moon': PROFILE=moon: expected one of "),
        (_changed(cell={"lines": []}), "cells[0].lines: []: expected a list of at least one quantity"),
        (_changed({"quantity": "luck"}), "cells[0].lines[0].quantity: 'luck': expected one of packets, "),
        (_changed({"of": "both"}), "cells[0].lines[0].of: 'both': expected ratio (MAVLink's over MQTT-XT's"),
        (_changed({"expected": -1}), "cells[0].lines[0].expected: -1: expected the published figure"),
        (_changed({"expected": 4}), "cells[0].lines[0].margin: [1, 3]: expected two numbers, the lower first, with "),
        (_changed({"margin": [3, 1]}), "cells[0].lines[0].margin: [3, 1]: expected two numbers, the lower first, "),
        (_changed({"margin": [1]}), "cells[0].lines[0].margin: [1]: expected two numbers from 0 on"),
        (_changed({"margin": ["a", 3]}), "cells[0].lines[0].margin[0]: 'a': expected a number from 0 on"),
        (_changed({"reason": ""}), "cells[0].lines[0].reason: '': expected a text that says why"),
        (_changed({"why": "?"}), "cells[0].lines[0].why: '?': unknown field: expected one of quantity, "),
        ({"attempts": 5, "seed": 7}, "cells: missing: expected a list of at least one experiment"),
        (_changed(cells=[CELL, CELL]), "cells[1]: 'scenario-1, arm thesis, profile ideal': expected each experiment"),
    ],
)
def test_a_mistake_in_the_table_is_one_line(tmp_path: Path, table: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError) as error:
        _read(tmp_path, table)
    assert str(error.value).removeprefix(f"{tmp_path}/own.yaml: ").startswith(said)
    assert "\n" not in str(error.value)
    assert error.value.exit_code == 2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"attempts": "0"}, "ATTEMPTS=0: expected a whole number from 1 to 99"),
        ({"seed": "-1"}, "SEED=-1: expected a whole number from 0 on, of 15 digits at most"),
        ({"seed": "9" * 16}, f"SEED={'9' * 16}: expected a whole number from 0 on, of 15 digits at most"),
    ],
)
def test_a_wrong_option_is_one_line(options: dict[str, str], said: str) -> None:
    with pytest.raises(UserError, match=said):
        read_headline(**options)
