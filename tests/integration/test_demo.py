"""`mqttxt demo`: its page and what it prints fly, and whatever ends it, no process and no file is left."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pmtiles.tile import TileType

from mqttxt.demo.fleet import PLACES
from mqttxt.demo.process import CLOUD_PORT, PAGE_PORT
from tests.rigs.demonstration import READY, Demonstration
from tests.rigs.installed import installed_demo
from tests.rigs.live_page import LivePage, done, is_ready
from tests.rigs.processes import ROOT, wait_until
from tests.simulation.map_tiles import pmtiles, png
from tests.tools.programs import chromium

pytestmark = [pytest.mark.integration, pytest.mark.apart, pytest.mark.timeout(400)]
PARTS = pytest.mark.soak("services/mqttxt/src/mqttxt/demo", "tests/rigs/demonstration.py")
"""One flight, and one part that is killed, stand for all, unless the demo itself has changed."""
PLACES_SHOWN = pytest.mark.soak("services/mqttxt/src/mqttxt/demo", "services/mqttxt/src/mqttxt/page")
ELSEWHERE = pytest.mark.soak(
    *(f"services/{part}/{what}" for part in ("mqttxt", "sitl") for what in ("src", "pyproject.toml")),
    *(f"tests/rigs/{rig}" for rig in ("as_macos", "demonstration.py", "installed.py")),
)


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[Demonstration]:
    with contextlib.closing(Demonstration(tmp_path)) as made:
        yield made


@contextlib.contextmanager
def port_taken(port: int) -> Iterator[None]:
    """Somebody listens there: the test, unless another one does."""
    with socket.socket() as sock:
        with contextlib.suppress(OSError):
            sock.bind(("127.0.0.1", port))
            sock.listen()
        yield


@PARTS
def test_what_it_prints_flies_beside_a_taken_port_and_an_impatient_ctrl_c_leaves_nothing(demo: Demonstration) -> None:
    with port_taken(CLOUD_PORT), port_taken(PAGE_PORT):
        demo.start()
        demo.wait_for(READY)
    assert f":{CLOUD_PORT}" not in demo.said()
    assert f":{PAGE_PORT}" not in demo.said()
    lines = [line for line in demo.printed() if not line.startswith(". ")]
    assert [line.split()[3] for line in lines if " send " in line] == ["arm", "takeoff", "goto", "land"]
    written = demo.type(lines)
    assert "MQTT-XT" in written
    assert written.count("takeoff completed") == written.count("land completed") == 4
    assert "goto completed" in written
    demo.signal(signal.SIGINT)
    demo.wait_for("ending")
    demo.signal(signal.SIGINT)
    assert demo.wait() == 0
    assert demo.nothing_is_left()
    assert "Traceback" not in demo.said()


@PARTS
@pytest.mark.skipif(chromium() is None, reason="no Chromium; `make tools` has it")
def test_its_page_is_opened_and_flies_and_typed_lines_take_over_from_it(demo: Demonstration, tmp_path: Path) -> None:
    opened, program = tmp_path / "opened", tmp_path / "browser"
    program.write_text(f'#!/bin/sh\necho "$1" > {opened}.new\nmv {opened}.new {opened}\nexec sleep 600\n')
    program.chmod(0o755)
    demo.start("--open", BROWSER=f"{program} %s")
    demo.wait_for(READY)
    wait_until(opened.exists, "a browser is opened")
    assert opened.read_text() == f"{demo.page()}\n"
    assert demo.said().index(demo.page()) < demo.said().index("drone 1 is ready")
    with LivePage() as browser:
        browser.open(demo.page())
        control = "[...document.querySelectorAll('#fleet-rows tr')].map(row => row.cells[4].innerText).join()"
        browser.until(f"{control}.match(/this station/g)?.length === 4", "the page controls all four")
        browser.click("tr[data-drone='1/1'] input")
        browser.click("#send-arm")
        browser.until("document.querySelectorAll('#orders li[data-word=completed]').length === 1", "armed")
        wanted = ("export ", "mqttxt gs send arm", "mqttxt gs send takeoff")
        assert demo.type([line for line in demo.printed() if line.startswith(wanted)]).count("takeoff completed") == 4
        browser.until_text("#log", "controlled by gs-")
        browser.until("document.querySelector('#notice').textContent === ''", "control is back")
        browser.click("#to-fog-1")
        browser.click("#send-land")
        landed = "document.querySelectorAll('#orders > li:first-child li[data-word=completed]').length === 4"
        browser.until(landed, "all four have landed", 60)
        assert browser.said == []
    demo.signal(signal.SIGINT)
    assert demo.wait() == 0, "though the browser that it opened runs on"


@PLACES_SHOWN
@pytest.mark.skipif(chromium() is None, reason="no Chromium; `make tools` has it")
def test_drone_2_flies_to_the_church_and_everybody_gets_down(demo: Demonstration, tmp_path: Path) -> None:
    tiles = pmtiles(tmp_path / "a.pmtiles", png((1, 2, 3)), TileType.PNG, *PLACES["Church"])
    demo.start("--tiles", os.path.relpath(tiles, ROOT))
    demo.wait_for(READY)
    with LivePage() as browser:
        browser.open(demo.page())
        is_ready(browser, 1, 2, 3, 4)
        assert browser.text("#map-credit") == "Map: A & B."
        browser.click("tr[data-drone='1/2'] th")
        browser.click("#send-arm")
        done(browser, "arm to drone 2")
        browser.click("#send-takeoff")
        done(browser, "takeoff altitude 10 m to drone 2")
        names = "[...document.querySelectorAll('.places text')].map(e => e.textContent).join()"
        assert browser.value(names) == ",".join(PLACES)
        browser.click(".places text")
        browser.until_text("#goto-distance", "Church, ")
        browser.click("#send-goto")
        done(browser, "(Church) to drone 2")
        browser.click("#to-fog-1")
        browser.click("#send-land")
        done(browser, "land to all drones of fog 1", drones=4)
        assert browser.said == []


@pytest.mark.parametrize(
    "number",
    [pytest.param(signal.SIGTERM, id="SIGTERM"), pytest.param(signal.SIGHUP, id="a closed terminal", marks=PARTS)],
)
def test_a_signal_while_it_starts_ends_it_clean(demo: Demonstration, number: signal.Signals) -> None:
    demo.start("--verbose")
    demo.wait_for("the activator: ")
    demo.signal(number)
    assert demo.wait() == 0
    assert demo.nothing_is_left()
    assert READY not in demo.said()


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("uav", "--drone 2"), "drone 2's UAV client"),
        pytest.param(("activator", "--fog"), "the activator", marks=PARTS),
        pytest.param(("sitl", "--system 3"), "drone 3's autopilot", marks=PARTS),
        pytest.param(("gs", "page"), "the page", marks=PARTS),
    ],
)
def test_a_part_that_is_killed_is_named_with_its_last_words(
    demo: Demonstration, words: tuple[str, str], name: str
) -> None:
    demo.start("--verbose")
    demo.wait_for("drone 1 is ready")
    os.kill(demo.part(*words), signal.SIGKILL)
    assert demo.wait() == 1
    (said,) = [line for line in demo.said().splitlines() if line.startswith("mqttxt: ")]
    assert said.startswith(f"mqttxt: {name} was ended by SIGKILL; its last words: ")
    wait_until(demo.nothing_is_left, "nothing is left")
    assert "Traceback" not in demo.said()


def test_a_part_that_ends_while_the_rig_ends_what_is_left_is_no_error(
    demo: Demonstration, monkeypatch: pytest.MonkeyPatch
) -> None:
    demo.mqttxt = Path("/bin/true")
    demo.start()
    gone = subprocess.Popen(["/bin/true"])
    gone.wait()
    monkeypatch.setattr(demo, "processes", lambda: {gone.pid: "true"})
    demo.close()


@ELSEWHERE
def test_a_station_without_what_linux_has_flies_and_the_parts_of_a_killed_demo_end(demo: Demonstration) -> None:
    demo.start()
    demo.wait_for(READY)
    (export,) = [line for line in demo.printed() if line.startswith("export ")]
    as_windows = f"{sys.executable} {ROOT}/tests/rigs/other_system.py mqttxt gs"
    commands = [f"send {command} --drone 1 --take-over" for command in ("arm", "takeoff 5", "land")]
    written = demo.type([export, *(f"{as_windows} {command}" for command in (*commands, "watch --fog 1"))])
    assert "drone 1: land completed" in written
    assert "on ground" in written
    demo.signal(signal.SIGKILL)
    wait_until(lambda: not demo.processes(), "no process is left")


@ELSEWHERE
def test_without_what_macos_lacks_it_flies_and_ends_clean(demo: Demonstration) -> None:
    as_macos = ROOT / "tests" / "rigs" / "as_macos"
    demo.start(PYTHONPATH=str(as_macos))
    demo.wait_for(READY)
    (export,) = [line for line in demo.printed() if line.startswith("export ")]
    commands = [f"mqttxt gs send {command} --drone 1 --take-over" for command in ("arm", "takeoff 5", "land")]
    written = demo.type([export, f"export PYTHONPATH={as_macos}", *commands])
    assert "drone 1: land completed" in written
    demo.signal(signal.SIGINT)
    assert demo.wait() == 0
    assert demo.nothing_is_left()
    assert "Traceback" not in demo.said()


@ELSEWHERE
def test_from_wheels_in_an_empty_virtual_environment_it_flies(tmp_path: Path) -> None:
    demo = Demonstration(tmp_path, installed_demo(tmp_path / "venv"))
    try:
        demo.start()
        demo.wait_for(READY)
        wanted = (". ", "export ", "mqttxt gs send arm", "mqttxt gs send takeoff", "mqttxt gs send land")
        lines = [line for line in demo.printed() if line.startswith(wanted)]
        assert len(lines) == len(wanted)
        assert demo.type([*lines, "command -v mqttxt"]).endswith(f"{demo.mqttxt}\n")
        demo.signal(signal.SIGTERM)
        assert demo.wait() == 0
        assert demo.nothing_is_left()
    finally:
        demo.close()
