"""What a flight's folder says of whether it counts, over either protocol."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from testbed.fly.observations import observe, verdict_of
from testbed.fly.results import Attempt, new_series, write_json
from testbed.fly.validity import Observed, Verdict
from tests.handmade.attempts import SECOND, T0, write_lines
from tests.handmade.mavlink_attempts import Chain, make_mavlink_attempt

EVENTS = [
    {"t_ns": T0, "event": "mission_start", "scenario": "scenario-1", "drones": [1, 2]},
    {"t_ns": T0 + 9 * SECOND, "event": "mission_end", "status": "completed", "reason": None},
]


@pytest.fixture
def flown(tmp_path: Path) -> Attempt:
    """Two drones over MAVLink."""
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    return make_mavlink_attempt(series, 1, Chain((1, 2)), EVENTS, disarmed_s=8)


def seen_of(attempt: Attempt, failure: str | None = None) -> Observed:
    return observe(attempt, attempt.manifest(), failure)


def test_an_attempt_with_everything_has_no_fault(flown: Attempt) -> None:
    assert seen_of(flown) == Observed()


@pytest.mark.parametrize(
    ("lost", "seen"),
    [
        ("pcap/captures.json", Observed(uncaptured=("cloud", "fog1", "gs", "uav1", "uav2"))),
        ("pcap/uav2.pcap", Observed(uncaptured=("uav2",))),
        ("events.jsonl", Observed(has_end=False)),
        ("sitl/uav2.jsonl", Observed(silent=("uav2",))),
    ],
)
def test_what_is_lost_is_named(flown: Attempt, lost: str, seen: Observed) -> None:
    (flown.path / lost).unlink()
    assert seen_of(flown) == seen


def test_a_drone_that_never_disarmed_leaves_no_end(flown: Attempt) -> None:
    path = flown.path / "sitl" / "uav1.jsonl"
    path.write_text(json.dumps({"t_ns": T0, "event": "armed"}) + "\n")
    assert seen_of(flown) == Observed(silent=("uav1",))


def test_captures_that_dropped_or_did_not_say_so_are_counted(flown: Attempt) -> None:
    path = flown.path / "pcap" / "captures.json"
    counts = {"gs": 3, "fog1": 0, "uav1": None}
    write_json(path, [one | {"dropped": counts.get(one["node"], 0)} for one in json.loads(path.read_text())])
    assert seen_of(flown) == Observed(dropped={"gs": 3, "uav1": None})


def test_what_captures_dropped_is_seen_of_a_failed_mission_too(flown: Attempt) -> None:
    counts = [{"node": "gs", "dropped": 3}, {"node": "cloud", "dropped": 0}]
    (flown.path / "pcap" / "captures.json").write_text(json.dumps(counts))
    assert seen_of(flown, "arm: denied") == Observed("arm: denied", dropped={"gs": 3})


def test_files_that_cannot_be_read_are_named_by_their_place_in_the_series_once(flown: Attempt) -> None:
    (flown.path / "events.jsonl").write_text("{}\n")
    (flown.path / "pcap" / "gs.pcap").write_text("no capture")
    events, capture = seen_of(flown).unreadable
    assert events == "mavlink/attempt-01/events.jsonl, line 1: expected an event with t_ns"
    assert capture.startswith("mavlink/attempt-01/pcap/gs.pcap: not a capture")


def test_of_a_failed_mission_only_its_conditions_are_observed(flown: Attempt) -> None:
    (flown.path / "pcap" / "gs.pcap").unlink()
    (flown.path / "links" / "counters.json").write_text(json.dumps({"links": {}, "void": "31 ms late"}))
    assert seen_of(flown, "arm: denied") == Observed("arm: denied", off_links=("31 ms late",))


def test_the_verdict_that_a_run_wrote_stands_and_one_that_wrote_no_observations_is_judged_now(flown: Attempt) -> None:
    (flown.path / "sitl" / "uav2.jsonl").unlink()
    manifest = flown.manifest()
    assert verdict_of(flown, manifest) == Verdict("void", ("no autopilot's own word of disarming: uav2",))
    assert verdict_of(flown, manifest | {"observed": {}}) == Verdict("completed")
    assert verdict_of(flown, manifest | {"status": "void", "reason": "links"}) == Verdict("void", ("links",))


def test_an_older_runs_failed_attempt_stays_failed_unless_the_shaper_was_late(flown: Attempt) -> None:
    slow = {"t_ns": T0, "event": "armed"}, {"t_ns": T0 + SECOND, "event": "clock", "boot_ms": 100}
    points = [*slow, {"t_ns": T0 + 2 * SECOND, "event": "clock", "boot_ms": 600}]
    write_lines(flown.path / "sitl" / "uav1.jsonl", points)
    manifest = flown.manifest() | {"status": "failed", "reason": "arm: denied"}
    assert seen_of(flown, "arm: denied").flights != ()
    assert verdict_of(flown, manifest) == Verdict("failed", ("arm: denied",))
    (flown.path / "links" / "counters.json").write_text(json.dumps({"links": {}, "void": "31 ms late"}))
    assert verdict_of(flown, manifest) == Verdict("void", ("31 ms late",), "arm: denied")
