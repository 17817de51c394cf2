"""Scenario 1 as people type it: flown, captured, measured and reported; and ended well when it goes wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import docker
import pytest

from testbed.containers import PROJECT, PROJECT_LABEL, SERVICE_LABEL
from testbed.results import open_series
from testbed.topology import ROOT

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(400)]


def containers() -> dict[str, object]:
    found = docker.from_env().containers.list(all=True, filters={"label": f"{PROJECT_LABEL}={PROJECT}"})
    return {container.labels[SERVICE_LABEL]: container for container in found}


@pytest.fixture(autouse=True)
def _nothing_is_left() -> Iterator[None]:
    yield
    assert containers() == {}


class Run:
    """`testbed run scenario-1` as a process whose lines can be waited for."""

    def __init__(self, results: Path) -> None:
        command = [sys.executable, "-m", "testbed", "run", "scenario-1", "--results", str(results)]
        self.results = results
        self.lines: list[str] = []
        self._said = threading.Condition()
        self._process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "COLUMNS": "120"},
        )
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._said:
                self.lines.append(line.rstrip())
                self._said.notify_all()

    @property
    def output(self) -> str:
        return "\n".join(self.lines)

    def wait_for(self, condition: Callable[[], bool], limit_s: float = 120) -> None:
        with self._said:
            assert self._said.wait_for(condition, limit_s), self.output

    def says(self, text: str) -> None:
        self.wait_for(lambda: any(text in line for line in self.lines))

    def interrupt(self) -> None:
        self._process.send_signal(signal.SIGINT)

    def wait(self) -> int:
        return self._process.wait(200)


def heard_topics(limit_s: int) -> dict[str, bytes]:
    """What `mosquitto_sub -v -t 'fog1/#'` shows beside a flight."""
    gs = containers()["gs"]
    command = ["mosquitto_sub", "-h", "198.18.1.3", "-t", "fog1/#", "-W", str(limit_s), "-F", "%t %x"]
    output = gs.exec_run(command).output.decode()  # type: ignore[attr-defined]
    return {line.split(" ")[0]: bytes.fromhex(line.split(" ")[1]) for line in output.splitlines() if " " in line}


def test_scenario_1_is_flown_measured_and_reported(tmp_path: Path) -> None:
    run = Run(tmp_path / "results")
    run.says("  arm ")
    topics = heard_topics(limit_s=40)
    assert run.wait() == 0, run.output

    assert {"fog1/commands", "fog1/commands_result/land", "fog1/clock", "fog1/reachable"} <= set(topics)
    assert b"mqtt://198.18.11.3:1883" in topics["fog1/reachable"]
    for drone in (1, 2, 3):
        assert {f"fog1/drone{drone}/state/location", f"fog1/drone{drone}/commands_result/land"} <= set(topics)

    series = open_series(run.results / "scenario-1" / "latest")
    metrics = json.loads((series.path / "metrics.json").read_text())
    (attempt,) = metrics["protocols"]["mqttxt"]["attempts"]
    assert attempt["status"] == "completed"
    assert 30 < attempt["mission_s"] < 120
    assert {drone: [o["word"] for o in said] for drone, said in attempt["outcomes"].items()} == {
        str(drone): ["completed"] * 3 for drone in range(1, 7)
    }
    assert set(attempt["links"]) == {
        f"{link}:{way}"
        for link in ("wan:gs", "backhaul:fog1", "backhaul:fog2", *(f"air:uav{n}" for n in range(1, 7)))
        for way in ("up", "down")
    }
    assert all(link["packets"] > 0 and link["lost"] == 0 for link in attempt["links"].values())
    assert sum(attempt["layers"].values()) == attempt["size_bytes"]
    assert attempt["message_loss"] == {"commands": 0.0, "states": 0.0}

    (flown,) = series.attempts()
    manifest = flown.manifest()
    assert all(capture["dropped"] == 0 and capture["captured"] > 0 for capture in manifest["captures"])
    assert len(manifest["captures"]) == 10
    assert all(json.loads(line)["event"] for line in (flown.path / "events.jsonl").read_text().splitlines())
    for drone, log in flown.autopilot_events().items():
        happened = [event["event"] for event in log if event["event"] not in ("position", "command", "mode")]
        assert happened == ["armed", "took_off", "landed", "disarmed"], drone
    page = (series.path / "report.html").read_text()
    assert "Over MQTT-XT 6 drones on two fogs flew scenario 1" in page
    assert "results" in run.lines[-1]
    assert run.lines[-1].endswith("report.html")


def test_ctrl_c_ends_all_containers_and_keeps_what_was_captured(tmp_path: Path) -> None:
    run = Run(tmp_path / "results")
    run.says("  arm ")
    run.interrupt()
    assert run.wait() == 130
    assert "interrupted; the containers are ended, what was captured is kept" in run.output
    (pcap,) = (tmp_path / "results").glob("scenario-1/thesis-ideal/*/mqttxt/attempt-01/pcap/gs.pcap")
    assert pcap.stat().st_size > 1000
    manifest = json.loads((pcap.parents[1] / "manifest.json").read_text())
    assert (manifest["status"], manifest["reason"]) == ("failed", "interrupted")


def test_a_container_that_dies_in_mid_mission_is_named_with_its_last_words(tmp_path: Path) -> None:
    run = Run(tmp_path / "results")
    run.says("  arm ")
    containers()["client3"].kill()  # type: ignore[attr-defined]
    assert run.wait() == 1
    assert "client3 ended with exit code 137; its last log lines:" in run.output
    assert "drone 3: heard its autopilot" in run.output
    metrics = json.loads((tmp_path / "results" / "scenario-1" / "latest" / "metrics.json").read_text())
    (attempt,) = metrics["protocols"]["mqttxt"]["attempts"]
    assert attempt["status"] == "failed"
    assert attempt["reason"].startswith("client3 ended")
