"""Scenario 1 in a fleet that signs: encrypted on every link, and measured as any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import polars as pl
import pytest

from net.probe import PORT as PROBES
from testbed.numbers.packets.table import load
from tests.e2e.agreement import assert_tshark_agrees
from tests.e2e.flying import Run, attempt_over, quick_drones

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.alone,
    pytest.mark.timeout(600),
    pytest.mark.soak(
        *("compose.yaml", "testbed/plan/identities.py", "testbed/fly/identities.py", "testbed/numbers/packets"),
        *("services/mqttxt/src/mqttxt/security", "services/mqttxt/src/mqttxt/core/mqtt"),
    ),
]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("signed")
    options = ("--protocols", "mqttxt", "--security", "signed")
    run = Run(folder / "results", *options, environment=quick_drones(folder))
    assert run.wait() == 0, run.output
    return run, run.metrics()["protocols"]["mqttxt"]["attempts"][0]


def test_it_is_flown_and_every_figure_is_there(flown: tuple[Run, dict[str, Any]]) -> None:
    _, attempt = flown
    assert {drone: [o["word"] for o in said] for drone, said in attempt["outcomes"].items()} == {
        str(drone): ["completed"] * 3 for drone in range(1, 7)
    }
    assert attempt["message_loss"] == {"commands": 0.0, "states": 0.0}
    assert {name: len(values) for name, values in attempt["delay_ms"].items()} == {"arm": 6, "takeoff": 6, "land": 6}
    assert sum(attempt["layers"].values()) == attempt["size_bytes"]
    assert attempt["layers"]["tls"] > attempt["layers"]["payload"] / 10


def test_nothing_of_it_is_plain_and_tshark_reads_the_same_with_the_same_keys(
    flown: tuple[Run, dict[str, Any]],
) -> None:
    run, _ = flown
    attempt = attempt_over(run, "mqttxt")
    flows = load(attempt).frames.filter(pl.col("payload") > 0)["flow"].cast(pl.String)
    ports = [set(both) - {f":{PROBES}"} for both in flows.str.extract_all(r":\d+").to_list()]
    assert all(":8883" in both for both in ports if both)
    assert_tshark_agrees(attempt)


def test_without_its_keys_it_has_no_figures_and_says_why(flown: tuple[Run, dict[str, Any]], tmp_path: Path) -> None:
    run, _ = flown
    attempt = attempt_over(run, "mqttxt")
    kept = attempt.key_log.rename(tmp_path / "keys.log")
    try:
        assert load(attempt).unread > 0
    finally:
        kept.rename(attempt.key_log)
