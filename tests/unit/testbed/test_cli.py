"""The `testbed` command: a mistake is one line with exit code 2, before anything starts."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from testbed.cli import commands as cli
from testbed.errors import DockerError
from testbed.fly.results import Series, new_attempt
from testbed.plan.overrides import FLEET_COPY
from testbed.present import reporting


def _run(*words: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(cli.app, words)
    return done.exit_code, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "scenario-1", "--protocols", "pigeon"], "PROTOCOLS=pigeon: expected one of mqttxt, mavlink"),
        (["run", "scenario-1", "--chain", "long"], "CHAIN=long: expected one of per-uav, shared, direct"),
        (["run", "scenario-1", "--qos", "2"], "QOS=2: expected one of 0, 1"),
        (["up", "--protocol", "mqttxt,mavlink"], "PROTOCOLS=mqttxt,mavlink: expected mqttxt or mavlink, one of them"),
        (["up", "--streams", "all"], "STREAMS=all: expected one of px4-onboard, px4-gcs, five-states"),
        (["up", "--encoding", "xml"], "ENCODING=xml: expected one of cbor, json"),
    ],
)
def test_a_mistake_is_one_line(words: list[str], said: str) -> None:
    assert _run(*words) == (2, "", f"testbed: {said}\n")


def test_arms_and_factors_are_shown() -> None:
    code, shown, _ = _run("arms")
    assert code == 0
    rows = {line.split()[0]: line.split() for line in shown.splitlines() if line[0].isalpha()}
    assert rows["QOS"] == ["QOS", "0", "0", "1", "1", "1", "0,", "1"]
    assert rows["STATES"][1:6] == ["on-change", "on-change", "fixed", "bundle", "on-change"]


@pytest.mark.parametrize("was_flown", [True, False])
def test_what_was_flown_is_reported_when_docker_is_lost(
    was_flown: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(_: Any, series: Series, __: Any) -> Any:
        attempt = new_attempt(series, "mqttxt", 1)
        if was_flown:
            (attempt.path / "events.jsonl").touch()
        raise DockerError("Docker does not answer")

    reported: list[Path] = []
    monkeypatch.setattr(cli, "only_run", lambda: None)
    monkeypatch.setattr(cli, "run_series", lost)
    monkeypatch.setattr(reporting, "report_series", lambda path, _: reported.append(path))
    code, _, said = _run("run", "scenario-1", "--results", str(tmp_path), "--qos", "1")
    assert (code, said) == (1, "testbed: Docker does not answer\n")
    assert [path.parent.name for path in reported] == (["thesis+qos-1-ideal"] if was_flown else [])


def test_a_fleet_is_ended_though_its_own_file_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ended = []
    monkeypatch.setattr(cli, "LIVE", tmp_path)
    monkeypatch.setattr(cli, "Containers", lambda *_: SimpleNamespace(down=lambda: ended.append(True)))
    (tmp_path / FLEET_COPY).write_text("fogs: [")
    assert _run("down")[0] == 0
    assert ended == [True]
