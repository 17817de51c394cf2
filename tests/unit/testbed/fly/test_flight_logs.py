"""Events that a witness wrote down, held to the autopilot's own flight log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from testbed.errors import ResultsError
from testbed.fly.flight_logs import against, compare, compare_flights, simulation_reason
from testbed.fly.results import Attempt
from tests.handmade.attempts import write_lines
from tests.handmade.ulog_files import Flight, write_ulog

BOOTED_NS = 1_795_000_000_000_000_000


def events_of(flight: Flight, speed: float = 1.0, **late_ms: float) -> list[dict[str, Any]]:
    """What a witness writes down of a flight: clocks five times a second, positions each second, and each change."""

    def host_ns(at_s: float) -> int:
        return BOOTED_NS + round(at_s / speed * 1e9)

    found: list[dict[str, Any]] = []
    for n in range(int(flight.disarmed_s + 2) * 5):
        at_s = n / 5
        found.append({"t_ns": host_ns(at_s) + 1_000_000, "event": "clock", "boot_ms": round(at_s * 1e3)})
        if n % 5 == 0:
            place = {"boot_ms": round(at_s * 1e3), "altitude_m": flight.height_at(at_s)}
            found.append({"t_ns": host_ns(at_s) + 2_000_000, "event": "position", **place})
    for name in ("armed", "took_off", "landed", "disarmed"):
        t_ns = host_ns(getattr(flight, f"{name}_s")) + round(late_ms.get(name, 20.0) * 1e6)
        found.append({"t_ns": t_ns, "event": name})
    return sorted(found, key=lambda event: int(event["t_ns"]))


@pytest.mark.parametrize("speed", [1.0, 0.97])
def test_events_that_the_log_bears_out_are_sound_whatever_the_clocks_speed(tmp_path: Path, speed: float) -> None:
    found = compare(write_ulog(tmp_path / "a.ulg", Flight()), events_of(Flight(), speed))
    assert found.off is None
    assert found.version == "main 02e73e3b6f"
    assert [change.event for change in found.changes] == ["armed", "took_off", "landed", "disarmed"]
    assert [change.late_ms for change in found.changes] == pytest.approx([19.0] * 4, abs=2.0)
    assert found.speed == pytest.approx(speed, abs=0.002)
    assert found.clock_ms < 1.0
    assert found.height_m == pytest.approx(0.0, abs=0.01)


def test_an_event_that_is_too_late_is_said_with_the_limit(tmp_path: Path) -> None:
    found = compare(write_ulog(tmp_path / "a.ulg", Flight()), events_of(Flight(), landed=760.0))
    assert found.off is not None
    assert found.off.startswith("events and flight log disagree: landed 759 ms after the log has it; expected 250 ms")


def test_what_only_one_of_both_has_is_said(tmp_path: Path) -> None:
    told = [event for event in events_of(Flight()) if event["event"] not in ("landed", "disarmed")]
    found = compare(write_ulog(tmp_path / "a.ulg", Flight()), told)
    both = "the events have armed took_off, the log armed took_off landed disarmed"
    assert found.off == f"events and flight log disagree: {both}"


def test_heights_that_differ_are_said(tmp_path: Path) -> None:
    found = compare(write_ulog(tmp_path / "a.ulg", Flight(height_m=12.0)), events_of(Flight(height_m=10.0)))
    assert found.height_m == pytest.approx(2.0, abs=0.01)
    assert found.off == "events and flight log disagree: heights by 2.0 m; expected 0.5 m at most"


def test_an_autopilot_whose_clock_was_held_up_flew_through_another_time_than_the_network(tmp_path: Path) -> None:
    found = compare(write_ulog(tmp_path / "a.ulg", Flight()), events_of(Flight(), speed=0.7))
    said = "the autopilot's clock ran at 0.700 of the time; expected 0.95 at least: the machine was too busy"
    assert found.off == said


def test_how_uncertain_the_times_are_is_measured_and_granted(tmp_path: Path) -> None:
    events = events_of(Flight(), landed=300.0)
    stalled = next(e for e in events if e["event"] == "clock" and e["boot_ms"] == 30_000)
    stalled["t_ns"] += 90_000_000
    found = compare(write_ulog(tmp_path / "a.ulg", Flight()), events)
    assert found.clock_ms == pytest.approx(90.0, abs=1.0)
    assert found.off is None


@pytest.fixture
def attempt(tmp_path: Path) -> Attempt:
    write_ulog(tmp_path / "sitl" / "uav1.log" / "2026-11-22" / "16_39_23.ulg", Flight())
    write_lines(tmp_path / "sitl" / "uav1.jsonl", events_of(Flight()))
    return Attempt(tmp_path, "mqttxt", 1)


def test_every_drone_with_a_log_is_compared_and_the_first_that_is_off_is_named(attempt: Attempt) -> None:
    found = compare_flights(attempt)
    assert list(found) == ["uav1"]
    assert against(attempt) is None
    assert found["uav1"].changes[0].event == "armed"
    write_lines(attempt.path / "sitl" / "uav1.jsonl", events_of(Flight(), armed=-900.0))
    assert str(against(attempt)).startswith("uav1: events and flight log disagree: armed -901 ms")


def test_an_attempt_of_stand_ins_has_nothing_to_compare(tmp_path: Path) -> None:
    assert compare_flights(Attempt(tmp_path, "mqttxt", 1)) == {}
    assert against(Attempt(tmp_path, "mqttxt", 1)) is None
    assert simulation_reason(Attempt(tmp_path, "mqttxt", 1)) is None


def test_the_logs_of_an_ardupilot_are_not_compared(tmp_path: Path) -> None:
    logs = tmp_path / "sitl" / "uav1.log"
    logs.mkdir(parents=True)
    (logs / "00000001.BIN").write_bytes(b"DataFlash")
    attempt = Attempt(tmp_path, "mqttxt", 1)
    assert (compare_flights(attempt), against(attempt), simulation_reason(attempt)) == ({}, None, None)


@pytest.mark.parametrize(
    ("topics", "said"),
    [
        (["vehicle_status"], "no vehicle_land_detected in it"),
        (None, "no flight log that can be read"),
        ([], "no flight log; expected"),
    ],
)
def test_a_log_that_is_missing_or_damaged_is_an_error(attempt: Attempt, topics: list[str] | None, said: str) -> None:
    (path,) = (attempt.path / "sitl").glob("*/*/*.ulg")
    if topics is None:
        path.write_bytes(b"no log at all, but long enough to have a head")
    elif topics:
        write_ulog(path, Flight(topics=topics))
    else:
        path.unlink()
    with pytest.raises(ResultsError, match=said):
        against(attempt)


def test_a_log_of_another_px4_whose_topics_have_other_fields_is_an_error(attempt: Attempt) -> None:
    (path,) = (attempt.path / "sitl").glob("*/*/*.ulg")
    path.write_bytes(path.read_bytes().replace(b" landed;", b" ground;"))
    with pytest.raises(ResultsError, match="vehicle_land_detected: expected timestamp and landed, as PX4 logs them"):
        against(attempt)


def test_events_without_clocks_cannot_be_compared(attempt: Attempt) -> None:
    told = [event for event in events_of(Flight()) if event["event"] != "clock"]
    write_lines(attempt.path / "sitl" / "uav1.jsonl", told)
    with pytest.raises(ResultsError, match="only 0 clock events"):
        compare_flights(attempt)


def test_in_a_flight_that_failed_only_its_simulation_counts(attempt: Attempt) -> None:
    cut = [event for event in events_of(Flight(), speed=0.6) if event["event"] not in ("landed", "disarmed")]
    write_lines(attempt.path / "sitl" / "uav1.jsonl", cut)
    assert str(simulation_reason(attempt)).startswith("uav1: the autopilot's clock ran at 0.600 of the time")
    write_lines(
        attempt.path / "sitl" / "uav1.jsonl", [event for event in events_of(Flight()) if event["event"] != "disarmed"]
    )
    assert simulation_reason(attempt) is None


@pytest.mark.parametrize(
    ("silent_s", "reason"),
    [
        ((10.0, 60.0), "uav1: the autopilot's simulated sensors stood still for 32.0 s; expected 2 s at most"),
        ((15.0, 16.9), None),
        ((1.0, 9.0), None),
        ((42.0, 60.0), None),
    ],
    ids=["from the arming on", "for a moment", "before it was armed", "after it was disarmed"],
)
def test_a_simulation_whose_sensors_stood_still_is_no_flight(
    attempt: Attempt, silent_s: tuple[float, float], reason: str | None
) -> None:
    write_ulog(next((attempt.path / "sitl" / "uav1.log").glob("*/*.ulg")), Flight(silent_s=silent_s, logged_s=6.0))
    assert against(attempt) == reason
    assert simulation_reason(attempt) == reason
