"""Every subcommand that is a ground station takes the same options of its fleet, and hands each on."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
import typer
from click.testing import CliRunner

from mqttxt.cli.main import app
from spec.options import subcommands

PLAN = Path(__file__).parent / "plans" / "survey.plan"
STATIONS = [
    "gs watch --fog 1",
    "gs send arm",
    "gs mavlink --fog 1 --to udp:127.0.0.1:14550",
    "gs metrics --fog 1",
    "gs homeassistant --fog 1 --broker mqtt://127.0.0.1",
    "gs page --fog 1",
    f"gs plan upload {PLAN} --drone 1",
    "gs plan download new.plan --drone 1",
    f"gs plan start {PLAN} --drone 1",
    "gs plan clear --drone 1",
    "gs plan watch --drone 1",
    "gs logs list --drone 1",
    "gs logs get 1 new.ulg --drone 1",
    "gs params list --drone 1",
    "gs params get NAME --drone 1",
    "gs params set NAME 1 --drone 1",
    "gs params save new.params --drone 1",
    "gs params load old.params --drone 1",
    "gs params diff old.params --drone 1",
]


OPTIONS = {
    "--cloud x": ("MQTTXT_CLOUD", "--cloud 'x': expected mqtt://HOST[:PORT]"),
    "--identity /nowhere": ("MQTTXT_IDENTITY", "identity /nowhere: no such folder"),
    "--signed": ("MQTTXT_SIGNED", "--signed: expected --identity beside it"),
    "--signed-states": ("MQTTXT_SIGNED_STATES", "--signed-states: expected --signed beside it"),
    "--signed-readings": ("MQTTXT_SIGNED_READINGS", "--signed-readings: expected --signed beside it"),
    "--insecure --cloud mqtt://x --timeout 0": ("MQTTXT_INSECURE", "--timeout 0: expected more than 0 s"),
    "--prefix '#'": (None, "prefix '#'"),
}


@pytest.fixture(scope="module")
def command() -> typer.main.click.Command:
    return typer.main.get_command(app)


@pytest.mark.parametrize("typed", STATIONS)
def test_each_option_of_the_fleet_reaches_the_station(
    command: typer.main.click.Command, typed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.params").write_text("1\t1\tNAME\t1\t6\n")
    for option, (_, said) in OPTIONS.items():
        done = CliRunner().invoke(command, shlex.split(f"{typed} {option}"))
        assert (done.exit_code, said in done.stderr) == (2, True), f"{option}: {done.output}"


def test_every_station_is_among_them_and_takes_them_from_the_environment_too() -> None:
    typed = {"-".join(words) for line in STATIONS for words in (line.split()[:2], line.split()[:3])}
    found = {path: command for path, command in subcommands().items() if path.startswith("gs-")}
    assert {*found} - typed == {"gs-share-list"}
    for path in {*found} & typed:
        variables = {f"--{parameter.name.replace('_', '-')}": parameter.envvar for parameter in found[path].params}
        for option, (variable, _) in OPTIONS.items():
            assert variables[option.split()[0]] == variable, path
