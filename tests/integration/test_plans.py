"""`mqttxt gs plan` as people type it, over real brokers and processes, with the stand-in as autopilot."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mqttxt import Plan
from tests.rigs import prefork
from tests.rigs.processes import ROOT, System, wait_until

pytestmark = [pytest.mark.integration]

SURVEY = ROOT / "tests" / "unit" / "mqttxt" / "plans" / "survey.plan"


def gs(shared_system: System, *words: str, timeout_s: float = 60) -> subprocess.CompletedProcess[str]:
    return prefork.run("mqttxt", "gs", *words, "--cloud", shared_system.cloud.url, timeout_s=timeout_s)


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """The survey's takeoff and return, near home, so that it is soon flown."""
    document = json.loads(SURVEY.read_text())
    items = document["mission"]["items"]
    items[0]["params"][6] = 6
    document["mission"]["items"] = [items[0], items[-1]]
    path = tmp_path / "short.plan"
    path.write_text(json.dumps(document))
    return path


def test_a_plan_goes_onto_a_drone_and_comes_back_as_a_file(shared_system: System, tmp_path: Path) -> None:
    done = gs(shared_system, "plan", "upload", str(SURVEY), "--drone", "1")
    assert done.returncode == 0, done.stderr
    assert "upload_plan completed" in done.stdout
    back = tmp_path / "back.plan"
    done = gs(shared_system, "plan", "download", str(back), "--drone", "1")
    assert (done.returncode, done.stdout) == (0, f"{back}: 6 mission items, 6 fence items, 2 rally points\n")
    assert Plan.load(back).content == Plan.load(SURVEY).content
    assert gs(shared_system, "plan", "clear", "--drone", "1").returncode == 0
    gs(shared_system, "plan", "download", str(back), "--drone", "1")
    assert str(Plan.load(back)) == "0 mission items, 0 fence items, 0 rally points"


def test_a_mission_is_started_followed_and_watched(shared_system: System, short: Path) -> None:
    assert gs(shared_system, "plan", "upload", str(short), "--drone", "2").returncode == 0
    told: list[str] = []
    watching = subprocess.Popen(
        [sys.executable, "-m", "mqttxt", "gs", "plan", "watch", "--drone", "2", "--cloud", shared_system.cloud.url],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert watching.stdout is not None
    reader = threading.Thread(target=lambda: told.extend(watching.stdout or ()), daemon=True)
    reader.start()
    try:
        denied = gs(shared_system, "plan", "start", str(short), "--drone", "2")
        assert denied.returncode == 1
        assert "denied(disarmed)" in denied.stdout
        assert gs(shared_system, "send", "arm", "--drone", "2").returncode == 0
        flown = gs(shared_system, "plan", "start", str(short), "--drone", "2", timeout_s=120)
        assert flown.returncode == 0, flown.stdout + flown.stderr
        assert "start_mission completed" in flown.stdout
        wait_until(lambda: any("reached 2" in line for line in told), "the watcher was told of the last item")
    finally:
        watching.terminate()
        watching.wait()
        reader.join()
    assert all(re.fullmatch(r"mission( \([0-9a-f]{8}\))?: item \d of 2, reached \d\n", line) for line in told), told


def test_a_mistake_is_one_line_before_anything_is_sent(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.plan"
    wrong.write_text(SURVEY.read_text().replace('"command": 206', '"command": 31999'))
    nobody = ["--cloud", "mqtt://127.0.0.1:1"]
    done = prefork.run("mqttxt", "gs", "plan", "upload", str(wrong), "--drone", "1", *nobody)
    assert done.returncode == 2
    line = f"mqttxt: {wrong}: mission item 3 (survey): command: expected a MAV_CMD of common.xml, got 31999\n"
    assert (done.stdout, done.stderr) == ("", line)
