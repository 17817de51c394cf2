"""Texts are put together from their parts, whatever is lost."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.mavlink.statustext import LONGEST, StatusTexts

WARNING, INFO = mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_INFO
A, B = "a" * 50, "b" * 50


def part(text: str, text_id: int = 0, number: int = 0, severity: int = WARNING) -> Any:
    return mavlink.MAVLink_statustext_message(severity, text.encode(), text_id, number)


@pytest.mark.parametrize(
    ("parts", "texts"),
    [
        ([part("low")], ["low"]),
        ([part(A)], [A]),
        ([part("low\t\x1b[2J")], ["low[2J"]),
        ([part("\t")], []),
        ([part(A, 1, 0), part("end", 1, 1)], [f"{A}end"]),
        ([part(A, 1, 0), part("", 1, 1)], [A]),
        ([part(B, 1, 1), part(A, 1, 0), part("end", 1, 2)], [f"{A}{B}end"]),
        ([part(A, 1, 0), part("low")], [A, "low"]),
        ([part(A, 1, 0), part(B, 2, 0), part("end", 2, 1)], [A, f"{B}end"]),
        ([part(A, 1, 0), part("end", 1, 2)], [f"{A}end"]),
        ([part(A, 1, 0)], []),
    ],
)
def test_a_text_ends_with_its_last_part_or_with_the_next_text(parts: list[Any], texts: list[str]) -> None:
    together = StatusTexts()
    assert [text for message in parts for _, text in together.take(message)] == texts


def test_an_unfinished_text_keeps_its_own_severity() -> None:
    together = StatusTexts()
    together.take(part(A, 1, 0, WARNING))
    assert together.take(part("low", severity=INFO)) == [(WARNING, A), (INFO, "low")]


def test_a_text_that_never_ends_is_cut() -> None:
    together = StatusTexts()
    assert [text for number in range(256) for text in together.take(part(A, 1, number))] == []
    assert together.end() == [(WARNING, (A * 4)[:LONGEST])]
    assert together.end() == []
