"""The page about packets: its tables name every column, its programs run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from testbed.cli.commands import app
from testbed.fly.results import Series, point_latest
from testbed.numbers.dissect import mavlink, mqtt5
from testbed.numbers.packets.rows import FRAME_SCHEMA, MESSAGE_SCHEMA
from tests.handmade.attempts import make_attempt

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "packets.md").read_text(encoding="utf-8")


def columns(heading: str) -> list[str]:
    """The names in the first column of the table behind a heading."""
    table = PAGE.split(heading, 1)[1].split("|---|---|\n", 1)[1].split("\n\n", 1)[0]
    return [name for row in table.splitlines() for name in re.findall(r"`([a-z_0-9]+)`", row.split("|")[1])]


def test_every_column_of_the_packets_table_is_explained() -> None:
    assert sorted(columns("`packets.parquet`: a frame")) == sorted(FRAME_SCHEMA.names())
    assert sorted(columns("`messages.parquet`: a message")) == sorted(MESSAGE_SCHEMA.names())


def test_every_option_of_the_command_is_explained() -> None:
    said = re.sub(r"\x1b\[[0-9;]*m", "", CliRunner().invoke(app, ["packets", "--help"]).output)
    options = set(re.findall(r"--[a-z]+", said)) - {"--help"}
    section = PAGE.split("## testbed packets", 1)[1].split("## The tables", 1)[0]
    assert options == set(re.findall(r"--[a-z]+", section))


@pytest.mark.parametrize("number", [0, 1])
def test_its_programs_run(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    series = Series(tmp_path / "results" / "scenario-1" / "thesis-ideal" / "20260101T000000Z")
    make_attempt(series)
    point_latest(series)
    program = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[number]
    monkeypatch.chdir(tmp_path)
    try:
        exec(program, {"__name__": "__main__"})
    finally:  # scapy's bindings are the process's
        mavlink.unbind()
        mqtt5.unbind()
    said = capsys.readouterr()
    assert said.err == ""
    assert ("publish" in said.out, "drone1/commands" in said.out) == ((True, False), (False, True))[number]
