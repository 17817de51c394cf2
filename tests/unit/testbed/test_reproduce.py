"""The command that flies the headline table and judges it: what it writes, how it ends, and how it goes on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from testbed.cli import reproduce as command
from testbed.cli.commands import app
from testbed.errors import Interrupted
from tests.handmade.finished import attempt, finished, gave_up
from tests.unit.testbed.plan.test_headline import CELL, LINE

NAME = {"experiment": "scenario-3", "arm": "direct", "profile": "lte"}


@pytest.fixture(autouse=True)
def _papers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("testbed.present.report.figures.files.pdf", lambda *_: b"%PDF")


def _table(folder: Path, **line: Any) -> Path:
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump({"attempts": 3, "seed": 7, "cells": [CELL | NAME | {"lines": [LINE | line]}]}))
    return path


def _run(folder: Path, table: Path, *words: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["reproduce", "--table", str(table), "--results", str(folder), *words])
    return done.exit_code, done.stdout, done.stderr


def _flown(folder: Path, *sizes: int) -> None:
    mqttxt = [attempt("mqttxt", n, size_bytes=100_000) for n, _ in enumerate(sizes, 1)]
    finished(folder, mqttxt, [attempt("mavlink", n, size_bytes=size) for n, size in enumerate(sizes, 1)], **NAME)


@pytest.mark.parametrize(
    ("sizes", "verdict", "code"),
    [
        ((200_000, 210_000, 190_000), "reproduced", 0),
        ((900_000, 910_000, 890_000), "not reproduced", 1),
        ((250_000, 310_000, 350_000), "undecided", 1),
    ],
)
def test_a_verdict_is_said_and_written_and_is_the_exit_code(
    tmp_path: Path, sizes: tuple[int, ...], verdict: str, code: int
) -> None:
    _flown(tmp_path, *sizes)
    ended, said, _ = _run(tmp_path, _table(tmp_path), "--no-fly")
    assert ended == code
    assert f"\n{verdict}: {int(code == 0)} of 1 line reproduced (seed 7)\n" in said
    document = json.loads((tmp_path / "reproduction.json").read_text())
    assert (document["verdict"], document["seed"], document["attempts"]) == (verdict, 7, 3)
    (cell,) = document["cells"]
    assert {key: cell[key] for key in NAME} == NAME
    assert cell["lines"][0]["points"] == {str(n): size / 100_000 for n, size in enumerate(sizes, 1)}
    page = (tmp_path / "reproduction.html").read_text()
    assert f'<p class="finding">{verdict.capitalize()}: {int(code == 0)} of 1 line reproduced.</p>' in page
    assert (tmp_path / "reproduction.csv").read_text().splitlines()[1].endswith(verdict)


def test_failed_and_void_attempts_are_named(tmp_path: Path) -> None:
    mqttxt = [attempt("mqttxt", n) for n in (1, 2, 3)]
    mavlink = [*(attempt("mavlink", n) for n in (1, 2)), gave_up("mavlink", "arm: drone 4: unconfirmed (timeout)", 3)]
    finished(tmp_path, mqttxt, mavlink, void=((2, "the emulator did not keep up"),), **NAME)
    code, said, _ = _run(tmp_path, _table(tmp_path), "--no-fly")
    where = "scenario-3, arm direct, profile lte"
    assert code == 1
    assert f"{where}: MAVLink, attempt 3: failed: arm: drone 4: unconfirmed (timeout)\n" in said
    assert f"{where}: MQTT-XT, attempt 2: void, flown again: the emulator did not keep up\n" in said
    assert "2 pairs, without 3" in " ".join(said.split())


def test_a_whole_series_is_judged_and_not_a_newer_one_that_was_broken_off(tmp_path: Path) -> None:
    """Docker was lost in the second attempt of the newer one, which was reported and is not flown to its end."""
    _flown(tmp_path, 200_000, 210_000, 190_000)
    finished(tmp_path, [attempt("mqttxt")], [attempt("mavlink")], name="20270101T000000Z", **NAME)
    code, said, _ = _run(tmp_path, _table(tmp_path), "--no-fly")
    assert (code, "1 of 1 line reproduced" in said) == (0, True)
    assert json.loads((tmp_path / "reproduction.json").read_text())["cells"][0]["series"] == "20260101T000000Z"


@pytest.mark.parametrize(("here", "said_so"), [("decaf", True), ("c0ffee", False), (None, False)])
def test_a_verdict_by_flights_of_another_revision_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, here: str | None, said_so: bool
) -> None:
    monkeypatch.setattr(command, "revision", lambda: {"commit": here, "dirty": False})
    _flown(tmp_path, 200_000, 210_000, 190_000)
    _, said, _ = _run(tmp_path, _table(tmp_path), "--no-fly")
    line = (
        "scenario-3, arm direct, profile lte: flown at c0ffee, not at decaf, which is here; "
        "another folder in --results flies it anew\n"
    )
    assert (line in said, "flown at" in said) == (said_so, said_so)


def test_what_was_not_flown_cannot_be_judged(tmp_path: Path) -> None:
    code, _, said = _run(tmp_path, _table(tmp_path), "--no-fly")
    assert code == 1
    assert said == (
        f"testbed: {tmp_path}: scenario-3, arm direct, profile lte: expected a measured series; "
        "fly it without --no-fly\n"
    )


def test_a_mistake_in_the_table_ends_with_2_before_anything_is_flown(tmp_path: Path) -> None:
    code, _, said = _run(tmp_path, _table(tmp_path, of="both"))
    assert code == 2
    assert said.startswith(f"testbed: {tmp_path}/own.yaml: cells[0].lines[0].of: 'both': expected ratio (")
    assert said.count("\n") == 1


def test_broken_off_it_says_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise Interrupted("interrupted; what was flown is kept")

    monkeypatch.setattr(command, "only_run", lambda: None)
    monkeypatch.setattr("testbed.cli.campaign.run_series", interrupted)
    code, _, said = _run(tmp_path, _table(tmp_path), "--seed", "11")
    assert code == 130
    assert said == "testbed: interrupted; what was flown is kept\nto go on, type: make reproduce SEED=11\n"
