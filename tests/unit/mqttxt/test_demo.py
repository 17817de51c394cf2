"""The demo's parts without drones: what is missing is one line, ports, last words, and nothing of a part is left."""

from __future__ import annotations

import importlib.util
import socket
import sys
import webbrowser
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mqttxt.cli.main import app
from mqttxt.core import mosquitto
from mqttxt.demo import parts, ports
from mqttxt.demo.fleet import DRONES, fleet_file
from mqttxt.demo.parts import DemoProcess
from mqttxt.demo.process import Demo
from mqttxt.errors import PartEnded
from sitl.fleet import load
from tests.rigs.processes import eventually
from tests.unit.mqttxt.test_embedded_broker_process import made, runs


@pytest.mark.parametrize(
    ("platform", "how"),
    [
        (
            "linux",
            "sudo apt-get install mosquitto (Fedora: sudo dnf install mosquitto, Arch: sudo pacman -S mosquitto)",
        ),
        ("darwin", "brew install mosquitto"),
        ("freebsd14", "see https://mosquitto.org/download"),
    ],
)
def test_without_mosquitto_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, platform: str, how: str) -> None:
    monkeypatch.setattr(mosquitto, "SYSTEM_FOLDERS", ())
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(sys, "platform", platform)
    done = CliRunner().invoke(app, ["demo"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == f"mqttxt: demo: Mosquitto is not installed; expected Mosquitto 2: {how}\n"


def test_mosquitto_is_found_where_packages_put_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "mosquitto"
    program.touch(mode=0o755)
    monkeypatch.setattr(mosquitto, "SYSTEM_FOLDERS", ("/nowhere", str(tmp_path)))
    monkeypatch.setenv("PATH", "")
    assert mosquitto.find() == str(program)


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        (
            "sitl",
            "expected the autopilot stand-in (mqttxt-sitl): in a clone of the repository, pip install ./services/sitl",
        ),
        ("aiohttp", "expected aiohttp, for the page: pip install 'mqttxt[demo]'"),
    ],
)
def test_without_a_package_it_says_what_installs_it(monkeypatch: pytest.MonkeyPatch, missing: str, said: str) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else name)
    done = CliRunner().invoke(app, ["demo"])
    assert (done.exit_code, done.stderr) == (2, f"mqttxt: demo: {said}\n")


def test_without_a_browser_it_does_not_open_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing() -> webbrowser.BaseBrowser:
        raise webbrowser.Error("could not locate runnable browser")

    monkeypatch.setattr(webbrowser, "get", nothing)
    monkeypatch.setattr(mosquitto, "find", lambda: "/usr/sbin/mosquitto")
    done = CliRunner().invoke(app, ["demo", "--open"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == "mqttxt: demo: --open: expected a browser on this machine\n"


@pytest.mark.long
async def test_a_page_that_cannot_be_served_is_named_with_its_words(tmp_path: Path) -> None:
    with pytest.raises(PartEnded, match=r"^the page ended with code 2; its last words: .*expected mqtt://HOST"):
        await Demo(print)._start_page(tmp_path, "no-address")


def test_a_taken_port_is_not_chosen() -> None:
    with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
        tcp.bind(("127.0.0.1", 0))
        udp.bind(("127.0.0.1", 0))
        taken = [tcp.getsockname()[1], udp.getsockname()[1]]
        assert [ports.is_free(port) for port in taken] == [False, False]
        chosen = ports.free_ports(*taken)
        assert not {next(chosen) for _ in range(20)} & {*taken}


def test_a_free_port_that_is_preferred_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "is_free", lambda port: port != 1890)
    assert next(ports.free_ports(1890, 1891)) == 1891


def test_the_stand_in_takes_the_fleet(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(fleet_file())
    homes = {load(path, number).home for number in DRONES}
    assert len(homes) == len(DRONES)


async def test_a_cloud_broker_that_loses_its_port_to_another_takes_the_next(tmp_path: Path) -> None:
    broker = script(
        tmp_path,
        f"cp $2 {tmp_path}/conf\n"
        f"[ -e {tmp_path}/lost ] || {{ touch {tmp_path}/lost; echo 'Error: Address already in use'; exit 1; }}\n"
        "echo 'mosquitto version 2.0.21 running'\nexec sleep 600",
    )
    demo = Demo(print)
    demo._ports = iter([15_001, 15_002])
    try:
        assert await demo._start_cloud(broker, tmp_path) == "mqtt://127.0.0.1:15002"
        assert "listener 15002 127.0.0.1\n" in (tmp_path / "conf").read_text()
    finally:
        await demo._end()


async def test_a_cloud_broker_that_cannot_run_is_named_with_its_words(tmp_path: Path) -> None:
    demo = Demo(print)
    with pytest.raises(PartEnded, match=r"^the cloud broker ended with code 2; its last words: .*cannot"):
        await demo._start_cloud(script(tmp_path, 'echo "cannot read $2"; exit 2'), tmp_path)


async def test_a_part_is_ended_with_what_it_started_though_neither_listens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parts, "END_S", 0.05)
    child = "trap '' TERM; echo $$ > child; while :; do sleep 600; done"
    part = DemoProcess(
        "a part", [script(tmp_path, f"trap '' TERM; sh -c \"{child}\" & wait; wait".replace("$$", r"\$\$"))], print
    )
    await part.start(tmp_path)
    told = tmp_path / "child"
    await eventually(lambda: told.exists() and told.read_text().strip(), "its child runs")
    await part.end()
    await eventually(lambda: not runs(int(told.read_text())), "its child has ended, too")
    assert str(part.last_words()) == "a part was ended by SIGKILL; its last words: none"


async def test_the_last_words_of_a_part_are_its_newest_lines(tmp_path: Path) -> None:
    heard: list[str] = []
    part = DemoProcess(
        "a part", [script(tmp_path, "for i in 1 2 3 4 5 6 7; do echo line $i >&2; done; exit 3")], heard.append
    )
    await part.start(tmp_path)
    await part.ended
    assert heard == [f"line {number}" for number in range(1, 8)]
    newest = " | ".join(heard[-parts.LAST_WORDS :])
    assert str(part.last_words()) == f"a part ended with code 3; its last words: {newest}"


def script(folder: Path, lines: str) -> str:
    """A program of these lines of shell."""
    return str(made(folder, f"#!/bin/sh\n{lines}\n"))


async def test_a_part_has_no_options_of_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Exported for another station, they would give the page an identity and signatures that the demo lacks."""
    monkeypatch.setenv("MQTTXT_IDENTITY", "elsewhere")
    monkeypatch.setenv("MQTTXT_SIGNED", "1")
    lines: list[str] = []
    program = "import os; print([name for name in os.environ if name.startswith('MQTTXT_')])"
    part = DemoProcess("it", (sys.executable, "-c", program), lines.append)
    await part.start(tmp_path)
    await part.ended
    assert lines == ["[]"]
