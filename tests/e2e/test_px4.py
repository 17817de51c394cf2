"""Real PX4s in the stand-ins' place; PX4_DIR names a build of it, as for `make scenario-1 AUTOPILOT=px4`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mission.message_set import COMMANDS, STATES
from tests.e2e.flying import Run

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.timeout(3600),
    pytest.mark.skipif("PX4_DIR" not in os.environ, reason="PX4_DIR names no PX4"),
]


@pytest.mark.parametrize("experiment", ["scenario-1", "scenario-4"])
def test_what_six_px4s_did_is_what_their_own_logs_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, experiment: str
) -> None:
    monkeypatch.setenv("AUTOPILOT", "px4")
    run = Run(tmp_path / "results", "--samples", "5", experiment=experiment)
    assert run.wait(3500) == 0, run.output
    for side in run.metrics()["protocols"].values():
        (attempt,) = side["attempts"]
        assert set(attempt["flight_logs"]) == {f"uav{drone}" for drone in range(1, 7)}
        for log in attempt["flight_logs"].values():
            assert log["off"] is None
            assert [change["event"] for change in log["changes"]] == ["armed", "took_off", "landed", "disarmed"]


def test_a_px4_flies_the_message_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over MQTT-XT: PX4 main refuses a goto from MAVSDK."""
    monkeypatch.setenv("AUTOPILOT", "px4")
    run = Run(tmp_path / "results", "--count", "1", "--protocols", "mqttxt", experiment="messages")
    assert run.wait(3500) == 0, run.output
    (attempt,) = run.metrics()["protocols"]["mqttxt"]["attempts"]
    assert {name: kind["received"] for name, kind in attempt["message_set"].items()} == dict.fromkeys(
        (*COMMANDS, *STATES), 1
    )
    assert attempt["flight_logs"]["uav1"]["off"] is None
