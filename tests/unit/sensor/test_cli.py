"""The `sensor` command: a value that cannot work is one line and exit code 2."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from sensor.cli import app

BROKER = ["--broker", "mqtt://127.0.0.1:1"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--broker", "http://there"], "--broker 'http://there': expected"),
        ([*BROKER, "--number", "0"], "--number 0: expected a whole number from 1"),
        ([*BROKER, "--kinds", "temperature,noise"], "--kinds 'temperature,noise': expected some of"),
        ([*BROKER, "--kinds", ""], "--kinds '': expected some of temperature,humidity,light"),
        ([*BROKER, "--rate", "nan"], "--rate nan: expected readings a second"),
        ([*BROKER, "--rate", "0"], "--rate 0: expected readings a second"),
        ([*BROKER, "--rate", "1e9"], "--rate 1e+09: expected readings a second"),
        ([*BROKER, "--samples", "-1"], "--samples -1: expected a whole number from 1"),
        ([*BROKER, "--keep", "0"], "--keep 0: expected a whole number from 1"),
        ([], "sensor: expected --broker: The broker that readings go to"),
        ([*BROKER, "--number", "x"], "sensor: --number 'x': expected a whole number"),
        ([*BROKER, "--events", "/proc/x/y"], "--events /proc/x/y: cannot be written: No such file"),
    ],
)
def test_a_bad_value_is_one_line(options: list[str], said: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, options)
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert said in line
