"""Scenario 3 on shaped links: calibrated, flown, counted by cause; and never flown on links that cannot be shaped."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from tests.e2e.flying import Run, attempt_over, few_drones, quick_drones

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(600)]

ONE_WAY_MS = {"air": 45.0, "backhaul": 15.0, "wan": 10.0}
"""The profile lte."""
JITTER_MS = 15.0
"""Of the air; normally distributed, and a drone's messages keep their order."""
LOSS = 0.002
COMMANDS = ("arm", "takeoff", "land")


WHOLE_FLEET = pytest.param(
    quick_drones,
    marks=[
        pytest.mark.alone,
        pytest.mark.soak(
            *("services/net/src", "testbed/fly/calibration", "testbed/fly/links.py", "tc_profiles/lte.yaml"),
            "testbed/numbers/packets/links.py",
        ),
    ],
    id="six drones",
)
"""The experiments' fleet: twice as many links to shape, and frames to count; a shaper of them needs its time."""


@pytest.fixture(scope="module", params=[pytest.param(few_drones, id="three drones"), WHOLE_FLEET])
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("flown")
    options = ["--profile", "lte"]
    run = Run(folder / "results", *options, experiment="scenario-3", environment=request.param(folder))
    assert run.wait() == 0, run.output
    return run, run.metrics()


@pytest.mark.parametrize("protocol", ["mqttxt", "mavlink"])
def test_a_mission_is_flown_on_links_that_were_measured_before_over(
    flown: tuple[Run, dict[str, Any]], protocol: str
) -> None:
    run, metrics = flown
    (attempt,) = metrics["protocols"][protocol]["attempts"]
    assert attempt["status"] == "completed"
    for drone, said in attempt["outcomes"].items():
        assert [(one["command"], one["word"]) for one in said] == [(name, "completed") for name in COMMANDS], drone
    manifest = attempt_over(run, protocol).manifest()
    assert manifest["profile"] == "lte"
    assert manifest["shaper"] in ("netem", "nfqueue")
    assert manifest["calibration"]["off"] == []
    delays_ms = [delay for delays in attempt["delay_ms"].values() for delay in delays]
    assert len(delays_ms) == len(COMMANDS) * len(attempt["outcomes"])
    assert median(delays_ms) > sum(ONE_WAY_MS.values()) - 2 * JITTER_MS, delays_ms  # a single one may be far shorter


def test_both_protocols_meet_the_same_links(flown: tuple[Run, dict[str, Any]]) -> None:
    run, _ = flown
    plans = [
        json.loads((attempt_over(run, protocol).path / "links" / "plan.json").read_text())["plan"]
        for protocol in ("mqttxt", "mavlink")
    ]
    assert plans[0] == plans[1]
    assert plans[0]["links"]["air:uav1:up"]["loss"] == LOSS


def test_what_the_captures_miss_is_what_the_shaper_dropped(flown: tuple[Run, dict[str, Any]]) -> None:
    """Over MAVLink; the counters begin with the calibration, the captures with the arming."""
    run, metrics = flown
    (attempt,) = metrics["protocols"]["mavlink"]["attempts"]
    counters = json.loads((attempt_over(run, "mavlink").path / "links" / "counters.json").read_text())
    assert counters["void"] is None
    for name, link in attempt["links"].items():
        dropped = counters["links"][name]
        assert link["lost"] <= dropped["random"] + dropped["queue"], name
        assert dropped["closed"] == 0
    on_air = [link for name, link in attempt["links"].items() if name.startswith("air") and name.endswith("up")]
    frames, lost = (sum(link[field] for link in on_air) for field in ("packets", "lost"))
    assert lost == pytest.approx(LOSS * frames, abs=5 * (LOSS * frames) ** 0.5), "within five standard deviations"


def test_a_kernel_without_netem_flies_nothing_where_netem_is_asked_for(tmp_path: Path) -> None:
    options = ["--profile", "lte", "--shaper", "netem", "--protocols", "mqttxt"]
    run = Run(tmp_path / "results", *options, experiment="scenario-3", environment=few_drones(tmp_path))
    if run.wait() == 0:
        assert attempt_over(run, "mqttxt").manifest()["shaper"] == "netem"
        return
    assert "testbed: the links cannot be shaped: net: " in run.output
    assert "netem" in run.lines[-1]
    assert not list((tmp_path / "results").glob("*/*/*/*/*/events.jsonl"))


def test_no_router_was_refused_by_the_next_one(flown: tuple[Run, dict[str, Any]]) -> None:
    """What would leave it with two sockets for a minute, one of them dead; but for MAVSDK, which comes last."""
    run, _ = flown
    logs = sorted((attempt_over(run, "mavlink").path / "logs").glob("router-*.log"))
    assert len(logs) == len(attempt_over(run, "mavlink").topology().nodes)
    for log in logs:
        closed = [line for line in log.read_text().splitlines() if "channel closed" in line]
        assert all("channel closed: udp:127.0.0.1:" in line for line in closed), log.name
