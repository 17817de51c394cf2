"""Scenarios 2 and 4 over both, in their shortest form; what sensors measured arrives whole."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from flying import Run, attempt_over

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(900)]

COMMANDS = ["arm", "takeoff", "goto", "return"]
ARMS = {"scenario-2": "five-states-bundled", "scenario-4": "thesis"}
SAMPLES = 1
SERIES = 18


@pytest.mark.parametrize("scenario", ARMS)
def test_every_drone_completes_every_command_of(scenario: str, tmp_path: Path) -> None:
    run = Run(tmp_path / "results", "--arm", ARMS[scenario], "--samples", str(SAMPLES), experiment=scenario)
    assert run.wait() == 0, run.output
    for protocol in ("mqttxt", "mavlink"):
        (attempt,) = run.metrics()["protocols"][protocol]["attempts"]
        assert attempt["status"] == "completed"
        for drone, said in attempt["outcomes"].items():
            assert [(o["command"], o["word"]) for o in said] == [(c, "completed") for c in COMMANDS], drone
        assert attempt["message_loss"]["commands"] == 0.0
        if scenario == "scenario-4":
            flight = attempt_over(run, protocol)
            series = json.loads((flight.path / "series.json").read_text())["series"]
            assert len(series) == SERIES
            assert all(one["whole"] and one["delivered"] == SAMPLES for one in series), series
            assert [
                {name: one[name] for name in told} for one, told in zip(attempt["series"], series, strict=True)
            ] == (series), "the files alone say the same as the mission"
            assert attempt["reading_delay_ms"]["captures"]["n"] == SERIES * SAMPLES
            changes = [json.loads(line) for line in (flight.path / "links" / "events.jsonl").read_text().splitlines()]
            opened = {change["link"] for change in changes if change.get("cause") == "range" and not change["change"]}
            assert opened == {f"sense:uav{drone}:{way}" for drone in range(1, 7) for way in ("up", "down")}
