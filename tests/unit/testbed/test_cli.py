"""The `testbed` command: a mistake is one line with exit code 2, before anything starts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from testbed.cli import commands as cli
from testbed.cli import live
from testbed.errors import DockerError, TestbedError
from testbed.fly.results import Series, new_attempt
from testbed.fly.validity import WATCHED, Verdict
from testbed.plan.experiments import ARMS, Plan
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


@pytest.mark.parametrize(
    "words",
    [
        ["verdict", "PATH", "--require", "ratios.packets>=50"],
        ["report", "PATH"],
        ["compare", "PATH", "PATH"],
    ],
)
@pytest.mark.parametrize(
    ("path", "said"),
    [("nothing", "expected a results folder"), ("", "expected a series, with <protocol>/attempt-NN in it")],
)
def test_a_path_that_is_no_series_is_a_mistake_too(words: list[str], path: str, said: str, tmp_path: Path) -> None:
    wrong = tmp_path / path
    assert _run(*(str(wrong) if word == "PATH" else word for word in words)) == (2, "", f"testbed: {wrong}: {said}\n")


@pytest.mark.parametrize(
    "words",
    [
        ["report", "PATH"],
        ["verdict", "PATH", "--require", "ratios.packets>=50"],
        ["compare", "PATH", "PATH"],
        ["packets", "PATH"],
        ["summary", "PATH"],
        ["profiles", "show", "PATH"],
        ["run", "scenario-4", "--profile", "PATH"],
    ],
)
def test_a_name_that_is_too_long_is_a_mistake_too(words: list[str]) -> None:
    code, shown, line = _run(*("x" * 256 if word == "PATH" else word for word in words))
    assert (code, shown, line.count("\n")) == (2, "", 1)
    assert line.endswith("File name too long; expected a shorter path\n")


def test_no_report_is_made_where_one_of_the_paths_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "series" / "mqttxt" / "attempt-01").mkdir(parents=True)
    reported: list[Path] = []
    monkeypatch.setattr(cli, "report_series", lambda path, _: reported.append(path))
    assert _run("report", str(tmp_path / "series"), str(tmp_path / "nothing"))[0] == 2
    assert reported == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "scenario-1", "--profle", "lte"], "run: no such option: --profle"),
        (["run"], "run: expected EXPERIMENT: What to fly: "),
        (["nope"], "no such command 'nope'; expected one of "),
        (["profiles", "nope"], "profiles: no such command 'nope'; expected show"),
        (["packets", "latest", "--rows", "many"], "packets: --rows 'many': expected a whole number"),
    ],
)
def test_what_is_no_command_line_is_one_line_too(words: list[str], said: str) -> None:
    code, shown, line = _run(*words)
    assert (code, shown, line.count("\n")) == (2, "", 1)
    assert line.startswith(f"testbed: {said}")


@pytest.mark.parametrize(
    "words", [["scheduler"], ["worker", "--scheduler", "tls://lab:1"], ["all", "--scheduler", "x"]]
)
def test_many_machines_need_a_certificate(words: list[str], tmp_path: Path) -> None:
    path = tmp_path / "campaign.pem"
    code, _, said = _run(*words, "--certificate", str(path))
    assert code == 2
    assert said.startswith(f"testbed: {path}: No such file or directory; expected the campaign's certificate")
    assert said.count("\n") == 1


@pytest.mark.parametrize("words", [["worker"], ["all"]])
def test_many_machines_need_a_schedulers_address(words: list[str], tmp_path: Path) -> None:
    path = tmp_path / "campaign.pem"
    assert _run("certificate", str(path))[0] == 0
    said = "testbed: SCHEDULER=tcp://lab:8786: expected tls://HOST:PORT, as `make scheduler` prints it\n"
    assert _run(*words, "--certificate", str(path), "--scheduler", "tcp://lab:8786") == (2, "", said)


def test_a_port_that_none_is_starts_no_scheduler(tmp_path: Path) -> None:
    """Dask listens at the remainder by 65536."""
    path = tmp_path / "campaign.pem"
    assert _run("certificate", str(path))[0] == 0
    said = "testbed: PORT=99999: expected a whole number from 1 to 65535\n"
    assert _run("scheduler", "--certificate", str(path), "--port", "99999") == (2, "", said)


def test_a_machine_without_docker_flies_for_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "campaign.pem"
    assert _run("certificate", str(path))[0] == 0
    monkeypatch.setattr("testbed.fly.campaign.certificate.check_scheduler", lambda *_: None)
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/docker.sock")
    code, _, said = _run("worker", "--scheduler", "tls://lab:8786", "--certificate", str(path))
    assert (code, said.count("\n")) == (2, 1)
    assert said.startswith("testbed: this machine cannot fly: Docker does not answer: ")


@pytest.mark.long
def test_one_machine_alone_needs_no_dask_and_a_run_no_scapy() -> None:
    alone = "import sys, testbed.cli.commands; sys.exit({'dask', 'distributed', 'scapy'} & set(sys.modules) != set())"
    assert subprocess.run([sys.executable, "-c", alone], check=False).returncode == 0


def test_arms_and_factors_are_shown() -> None:
    code, shown, _ = _run("arms")
    assert code == 0
    rows = {line.split()[0]: line.split() for line in shown.splitlines() if line[0].isalpha()}
    assert rows["QOS"] == ["QOS", "0", "0", "1", "1", "1", "1", "0,", "1"]
    assert shown.splitlines()[0].split() == [*ARMS, "can", "be"]
    assert rows["STATES"][1:6] == ["on-change", "on-change", "fixed", "bundle", "on-change"]


@pytest.mark.parametrize("was_flown", [True, False])
def test_what_was_flown_is_reported_when_docker_is_lost(
    was_flown: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(_: Any, series: Series, *__: Any) -> Any:
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


@pytest.mark.parametrize(
    ("ending", "code"),
    [(Verdict("void", (WATCHED,)), 0), (Verdict("void", (WATCHED,), "denied"), 1), (Verdict("void", ("late",)), 1)],
)
def test_flights_that_the_page_shows_are_judged_by_their_missions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: Verdict, code: int
) -> None:
    flown: list[Plan] = []

    def fly(plan: Plan, *_: object) -> list[Verdict]:
        flown.append(plan)
        return [ending]

    monkeypatch.setattr(cli, "only_run", lambda: None)
    monkeypatch.setattr(cli, "run_series", fly)
    monkeypatch.setattr(cli, "report_series", lambda *_: {})
    found, said, _ = _run("run", "scenario-1", "--page", "--results", str(tmp_path))
    assert found == code
    (plan,) = flown
    assert f"the page: http://127.0.0.1:{plan.page}/ (what it shows does not count)" in said


@pytest.mark.parametrize("error", [None, "the page is not served: no room"])
def test_a_fleet_that_is_up_says_where_its_page_is_or_why_it_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: str | None
) -> None:
    ports: list[int | None] = []

    def start_page(plan: Plan, *_: object, watch_only: bool) -> None:
        ports.append(plan.page)
        assert not watch_only
        if error is not None:
            raise TestbedError(error)

    containers = SimpleNamespace(count=23, down=lambda: None, start=lambda: None, name_of=str)
    monkeypatch.setattr(live, "LIVE", tmp_path / "live")
    monkeypatch.setattr(live, "only_run", lambda: None)
    monkeypatch.setattr(live, "Containers", lambda *_: containers)
    monkeypatch.setattr(live, "start_page", start_page)
    code, shown, said = _run("up", "--security", "none")
    assert code == 0
    assert (f"the page: http://127.0.0.1:{ports[0]}/" in shown) is (error is None)
    assert said == ("" if error is None else f"testbed: {error}\n")
    assert "mqttxt gs watch --fog 1 --fog 2" in shown


def test_a_fleet_is_ended_though_its_own_file_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ended = []
    monkeypatch.setattr(live, "LIVE", tmp_path)
    monkeypatch.setattr(live, "Containers", lambda *_: SimpleNamespace(down=lambda: ended.append(True)))
    (tmp_path / FLEET_COPY).write_text("fogs: [")
    assert _run("down")[0] == 0
    assert ended == [True]
