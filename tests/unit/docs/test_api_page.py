"""docs/api.md names every public name, and every parameter of GroundStation."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import mqttxt

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "api.md").read_text(encoding="utf-8")
OF_TESTS = {"clock"}


def test_every_public_name_is_on_the_page() -> None:
    assert [name for name in mqttxt.__all__ if not re.search(rf"\b{name}\b", PAGE)] == []


def test_every_parameter_of_a_station_is_in_its_row() -> None:
    (row,) = re.findall(r"^\| `GroundStation\(([^)]*)\)`", PAGE, re.MULTILINE)
    given = set(inspect.signature(mqttxt.GroundStation).parameters) - OF_TESTS
    assert {name.strip() for name in row.split(",")} - {"*"} == given
