"""Metrics of a series whose answers were counted by hand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from attempts import make_attempt

from testbed.errors import ResultsError
from testbed.metrics import measure_series
from testbed.results import new_series


def test_every_number_of_a_tiny_attempt(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    make_attempt(series)
    metrics = measure_series(series)
    (measured,) = metrics["protocols"]["mqttxt"]["attempts"]

    assert measured["status"] == "completed"
    assert measured["mission_s"] == 9.0  # the command left at 0, the drone disarmed at 4 + 5
    assert measured["packets"] == 7
    # headers 54, MQTT 5 beside its topic, payload 11; the topic has 13 characters on wan and backhaul, 15 on air
    command = 54 + 5 + 11
    state_up, state_down = 54 + 5 + 20 + 6, 54 + 5 + 25 + 7
    expected = {
        "wan:gs:up": (1, command + 13),
        "backhaul:fog1:down": (1, command + 13),
        "air:uav1:down": (1, command + 15),
        "air:uav1:up": (2, state_up + 54),
        "backhaul:fog1:up": (1, state_down),
        "wan:gs:down": (1, state_down),
    }
    assert {name: (link["packets"], link["bytes"]) for name, link in measured["links"].items()} == expected
    assert measured["size_bytes"] == sum(size for _, size in expected.values())
    assert {name: link["lost"] for name, link in measured["links"].items() if link["lost"]} == {"air:uav1:up": 1}
    assert measured["wire_loss"] == pytest.approx(1 / 7)
    assert measured["message_loss"] == {"commands": 0.0, "states": 0.0}
    assert (measured["commands_sent"], measured["states_sent"]) == (1, 1)
    assert measured["delay_ms"] == {"arm": [2.5]}  # by the capture at uav1: 2 ms and half a millisecond of air
    assert measured["outcomes"] == {"1": [{"command": "arm", "word": "completed", "reason": None, "after_ms": 10.0}]}
    assert measured["mqtt"] == {"publish": 6}
    assert measured["before_mission"] == {"packets": 1, "bytes": 54}
    assert measured["foreign"] == {"other": 1}
    assert measured["truncated"] == []
    assert json.loads((series.path / "metrics.json").read_text()) == metrics


def test_a_capture_that_dropped_packets_makes_the_attempt_void(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    make_attempt(series)
    make_attempt(series, number=2, dropped=3)
    side = measure_series(series)["protocols"]["mqttxt"]
    assert [attempt["attempt"] for attempt in side["attempts"]] == [1]
    assert side["void"] == [{"attempt": 2, "reason": "captures dropped packets (gs: 3, cloud: 3, fog1: 3, uav1: 3)"}]


def test_a_failed_attempt_stays_with_its_reason_and_without_a_mission_time(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    make_attempt(series, status="failed", reason="takeoff: drone 1: denied")
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert (measured["status"], measured["reason"]) == ("failed", "takeoff: drone 1: denied")
    assert measured["mission_s"] is None
    assert measured["packets"] == 7


def test_an_attempt_that_never_flew_has_no_traffic(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    attempt = make_attempt(series, status="failed", reason="connect: fog 1")
    (attempt.path / "events.jsonl").unlink()
    (measured,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert (measured["packets"], measured["mission_s"], measured["wire_loss"]) == (0, None, None)


def test_a_series_never_mixes_conditions(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    make_attempt(series)
    make_attempt(series, number=2, profile="lte")
    with pytest.raises(ResultsError, match=r"attempt-02: profile is lte, in the first attempt ideal"):
        measure_series(series)


@pytest.mark.parametrize(
    ("text", "said"),
    [("{", "not JSON"), ("[]", "expected an object"), ("{}", "experiment is missing")],
)
def test_a_manifest_that_is_off_is_named(tmp_path: Path, text: str, said: str) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    attempt = make_attempt(series)
    (attempt.path / "manifest.json").write_text(text)
    with pytest.raises(ResultsError, match=rf"manifest\.json: {said}"):
        measure_series(series)
