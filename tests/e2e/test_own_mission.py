"""A mission of one's own that goes wrong, by another fleet: one line for people, the rest in its attempt's folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.e2e.flying import Run, attempt_over

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.timeout(300),
    pytest.mark.soak(
        *("testbed/cli", "testbed/fly", "testbed/plan/own_missions.py"),
        *(f"services/mission/src/mission/{name}.py" for name in ("__main__", "own", "steps")),
    ),
]

MISSION = """
async def mission(fleet, steps):
    await steps.command("arm", fleet.arm, limit_s=30)
    print(f"{len(fleet.drones)} drones are armed")
    await look_at(fleet, "the lake")


async def look_at(fleet, place):
    await fleet.goto({1: {}[place]})
"""


def test_what_it_raises_is_one_line_and_its_traceback_is_kept(tmp_path: Path) -> None:
    (tmp_path / "lake.py").write_text(MISSION)
    fleet, mission = {"FOGS": "3", "DRONES": "3"}, str(tmp_path / "lake.py")
    run = Run(tmp_path / "results", "--protocols", "mqttxt", experiment=mission, verb="fly", environment=fleet)
    assert run.wait(280) == 1, run.output
    assert "lake.py, line 9: KeyError: 'the lake'" in run.output
    assert "Traceback" not in run.output
    attempt = attempt_over(run, "mqttxt")
    assert (attempt.manifest()["status"], attempt.manifest()["reason"]) == (
        *("failed", "lake.py, line 9: KeyError: 'the lake'"),
    )
    said = (attempt.path / "logs" / "mission.log").read_text()
    assert "3 drones are armed" in said
    assert "in look_at" in said
    assert (attempt.path / "lake.py").read_text() == MISSION
    assert len(attempt.topology().nodes) == 2 + 3 + 3
    assert "line 9: KeyError" in (run.latest / "report.html").read_text()
