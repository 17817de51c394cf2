"""The share of commands and words in a series' bytes, on rows made by hand."""

from __future__ import annotations

import polars as pl
import pytest

from tests.bench.words import shares


def test_what_acknowledges_is_shared_by_bytes_on_its_own_stage() -> None:
    rows = [
        ("air:uav1:up", "result", 100),
        ("air:uav2:up", "result", 50),
        ("air:uav1:down", "command", 50),
        ("air:uav1:up", "state", 200),
        ("air:uav1:down", "acknowledgement", 40),
        ("wan:gs:down", "result", 80),
    ]
    found = shares(pl.DataFrame(rows, schema=["link", "purpose", "size"], orient="row"))
    assert found["air"] == {"result": (2, pytest.approx(165)), "command": (1, pytest.approx(55))}
    assert found["wan"] == {"result": (1, 80.0)}
