"""The station's side on systems that lack what Linux has; what needs POSIX says so."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mqttxt.core.clock import system_clock_ns
from mqttxt.security.identity import KEY_FILE
from testbed.bootstrap import steps
from tests.rigs.processes import ROOT, wait_until
from tests.unit.mqttxt.typed import refused

pytestmark = pytest.mark.long

AS_WINDOWS = (sys.executable, str(ROOT / "tests" / "rigs" / "other_system.py"))
NOWHERE = ("--cloud", "mqtt://127.0.0.1:1", "--timeout", "0.2")
EVERY_MODULE = """
import importlib, pkgutil
import mqttxt.cli, mqttxt.gateway, mqttxt.page, mqttxt.protocol, mqttxt.security, mqttxt.station
import mqttxt.homeassistant, mqttxt.metrics

found = []
for package in (mqttxt.cli, mqttxt.gateway, mqttxt.page, mqttxt.protocol, mqttxt.security, mqttxt.station):
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        found.append(importlib.import_module(module.name))
print(len(found))
"""
STATION = """
import asyncio
from mqttxt import GroundStation, MqttxtError

async def main():
    async with GroundStation("mqtt://127.0.0.1:1") as station:
        await station.connect([1], timeout_s=0.2)

for run in (asyncio.run, asyncio.Runner(loop_factory=asyncio.SelectorEventLoop).run):
    try:
        run(main())
    except MqttxtError as error:
        print(type(error).__name__, error)
"""


def on_windows(*typed: str, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*AS_WINDOWS, *typed], cwd=folder, capture_output=True, text=True, timeout=100, check=False)


def test_every_module_of_the_station_is_loaded_without_what_linux_has(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(EVERY_MODULE)
    done = on_windows(str(program))
    assert done.stderr == ""
    assert int(done.stdout) > 60


@pytest.mark.parametrize("command", [("gs", "send", "arm"), ("gs", "watch", "--fog", "1")], ids=" ".join)
def test_a_station_asks_for_its_broker(command: tuple[str, ...]) -> None:
    done = on_windows("mqttxt", *command, *NOWHERE)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("mqttxt: fog 1: no connection to mqtt://127.0.0.1:1 (")
    assert "Traceback" not in done.stderr


def test_the_gateway_opens_its_sockets_once_its_broker_is_there() -> None:
    done = on_windows("mqttxt", "gs", "mavlink", "--fog", "1", "--to", "udp:127.0.0.1:14550", *NOWHERE)
    assert (done.returncode, "Traceback" in done.stderr) == (1, False)


def test_a_program_in_an_event_loop_without_sockets_is_told_which_one_has_them(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(STATION)
    done = on_windows(str(program))
    assert "Traceback" not in done.stderr
    refused, tried = done.stdout.splitlines()
    assert refused == (
        "ConfigurationError event loop ProactorEventLoop: does not watch sockets; "
        "expected that of asyncio.Runner(loop_factory=asyncio.SelectorEventLoop)"
    )
    assert tried.startswith("FogUnreachable fog 1: no connection to mqtt://127.0.0.1:1 (")


def test_keys_are_made_and_used_where_files_have_no_modes(tmp_path: Path) -> None:
    asked = ("keys", "init", "acme", "--fogs", "1", "--drones", "1", "--station", "ops")
    made = on_windows("mqttxt", *asked, folder=tmp_path)
    assert made.returncode == 0, made.stderr
    authority = tmp_path / "acme"
    keys = [*authority.glob(f"*/{KEY_FILE}")]
    assert len(keys) > 3
    for key in keys:
        key.chmod(0o666)
    options = ("--identity", str(authority / "broker-cloud"), "--out", str(tmp_path / "cloud"))
    broker = on_windows("mqttxt", "broker", "cloud", *options)
    assert broker.returncode == 0, broker.stderr
    station = ("--identity", str(authority / "gs-ops"), "--cloud", "mqtts://127.0.0.1:1", "--timeout", "0.2")
    sent = on_windows("mqttxt", "gs", "send", "arm", *station)
    assert (sent.returncode, sent.stderr.splitlines()[-1][:24]) == (1, "mqttxt: fog 1: no connec")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_station_whose_loop_knows_of_none(number: signal.Signals, code: int, tmp_path: Path) -> None:
    log = tmp_path / "log"
    command = ("mqttxt", "gs", "watch", "--fog", "1", "--cloud", "mqtt://127.0.0.1:1", "--timeout", "100")
    with log.open("wb") as output, subprocess.Popen([*AS_WINDOWS, *command], stdout=output, stderr=output) as watching:
        try:
            wait_until(lambda: "trying again" in log.read_text(), "it runs")
            watching.send_signal(number)
            assert watching.wait(30) == code
        finally:
            watching.kill()
    assert "Traceback" not in log.read_text()


@pytest.mark.parametrize(
    "typed", ["activator --fog 1 --cloud mqtt://127.0.0.1", "uav --drone 1 --broker mqtt://127.0.0.1", "demo"]
)
def test_what_needs_posix_says_so_on_windows(monkeypatch: pytest.MonkeyPatch, typed: str) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    role, *_ = words = typed.split()
    assert refused(*words) == f"{role}: runs on Linux and macOS, not on Windows; expected one of those, or WSL"


def test_the_testbed_says_that_it_is_linuxs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setattr(sys, "argv", ["testbed", "venv"])
    assert steps.command("testbed.bootstrap", "testbed", {"venv": pytest.fail}) == 2
    assert capsys.readouterr().err.startswith("testbed: runs on Linux, not on darwin")


def test_the_clock_is_the_finest_that_windows_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(time, "clock_gettime_ns")
    monkeypatch.setattr(time, "perf_counter_ns", lambda: 12_345)
    assert system_clock_ns() == 12_345


def test_the_clock_of_macos_counts_suspend_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(time, "CLOCK_BOOTTIME", raising=False)
    monkeypatch.setattr(time, "clock_gettime_ns", {time.CLOCK_MONOTONIC_RAW: 12_345}.__getitem__)
    assert system_clock_ns() == 12_345


def test_characters_that_an_output_does_not_have_are_written_as_escapes() -> None:
    loaded = "import importlib; cli = importlib.import_module('mqttxt.cli.main')"
    code = f"{loaded}; cli.app = lambda: print('\\u6f22'); cli.main()"
    shown = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONIOENCODING": "cp1252"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (shown.returncode, shown.stdout) == (0, "\\u6f22\n"), shown.stderr
