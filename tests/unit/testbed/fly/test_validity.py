"""Whether an attempt's numbers can stand, over either protocol: every capture whole, every drone's own word there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from attempts import SECOND, T0
from mavlink_attempts import Chain, make_mavlink_attempt

from testbed.fly.results import Attempt, new_series
from testbed.fly.validity import unsound_reason, void_reason

EVENTS = [
    {"t_ns": T0, "event": "mission_start", "scenario": "scenario-1", "drones": [1, 2]},
    {"t_ns": T0 + 9 * SECOND, "event": "mission_end", "status": "completed", "reason": None},
]


@pytest.fixture
def flown(tmp_path: Path) -> Attempt:
    """Two drones over MAVLink."""
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    return make_mavlink_attempt(series, 1, Chain((1, 2)), EVENTS, disarmed_s=8)


def _reason(attempt: Attempt) -> str | None:
    return unsound_reason(attempt, attempt.manifest(), attempt.events())


def test_an_attempt_with_everything_is_sound(flown: Attempt) -> None:
    assert _reason(flown) is None


@pytest.mark.parametrize(
    ("lost", "reason"),
    [
        ("pcap/uav2.pcap", "no capture at uav2"),
        ("events.jsonl", "events.jsonl does not have the mission's end"),
        ("sitl/uav2.jsonl", "no autopilot's own word of disarming: uav2"),
    ],
)
def test_what_is_lost_is_named(flown: Attempt, lost: str, reason: str) -> None:
    (flown.path / lost).unlink()
    assert _reason(flown) == reason


def test_a_drone_that_never_disarmed_leaves_no_end(flown: Attempt) -> None:
    path = flown.path / "sitl" / "uav1.jsonl"
    path.write_text(json.dumps({"t_ns": T0, "event": "armed"}) + "\n")
    assert _reason(flown) == "no autopilot's own word of disarming: uav1"


def test_captures_that_dropped_or_did_not_say_so_are_named() -> None:
    counts = [{"node": "gs", "dropped": 3}, {"node": "fog1", "dropped": 0}, {"node": "uav1", "dropped": None}]
    assert void_reason(counts, ["gs", "fog1", "uav1"]) == "captures dropped packets: gs 3, uav1 ?"
    assert void_reason(counts, ["cloud", "fog1"]) == "no capture at cloud"
