"""Results that are damaged, half written, old or mixed: one line each, and whatever can be read is measured."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from testbed.errors import ResultsError
from testbed.fly.results import Series, new_series, read_json, write_json
from testbed.numbers.metrics import measure_series
from tests.handmade.attempts import SECOND, T0, frame, make_attempt, manifest, write_pcap


@pytest.fixture
def series(series: Series) -> Series:
    make_attempt(series)
    return series


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("manifest.json", None, "mqttxt/attempt-02/manifest.json: No such file or directory"),
        ("manifest.json", '{"version": 1', "mqttxt/attempt-02/manifest.json: not JSON"),
        ("manifest.json", "[]", "mqttxt/attempt-02/manifest.json: expected an object"),
        ("manifest.json", "{}", "mqttxt/attempt-02/manifest.json: version is None, expected 1"),
        ("manifest.json", '{"version": 0}', "mqttxt/attempt-02/manifest.json: version is 0, expected 1"),
        ("manifest.json", '{"version": 1}', "mqttxt/attempt-02/manifest.json: experiment is missing"),
        (
            "manifest.json",
            '{"version": 1, "experiment": []}',
            "mqttxt/attempt-02/manifest.json: experiment: expected text",
        ),
        (
            "manifest.json",
            json.dumps(manifest(status="great")),
            "mqttxt/attempt-02/manifest.json: status is great, expected completed, failed or void",
        ),
        ("events.jsonl", "{}\n", "mqttxt/attempt-02/events.jsonl, line 1: expected an event with t_ns"),
        (
            "events.jsonl",
            '{"t_ns": 1, "event": "command", "command": "arm"}\n',
            "mqttxt/attempt-02/events.jsonl, line 1: command: call is missing, as of another version",
        ),
        (
            "events.jsonl",
            '{"t_ns": 1, "event": "mission_start", "scenario": "scenario-1", "drones": null}\n',
            "mqttxt/attempt-02/events.jsonl, line 1: mission_start: drones is None, as of another version",
        ),
        (
            "sitl/uav1.jsonl",
            '{"t_ns": "now", "event": "disarmed"}\n',
            "mqttxt/attempt-02/sitl/uav1.jsonl, line 1: t_ns is 'now', expected nanoseconds",
        ),
        (
            "sitl/uav1.jsonl",
            f'{{"t_ns": {T0 + 10**15}, "event": "disarmed"}}\n',
            "mqttxt/attempt-02: a mission of 1000000 s, expected at most 86400 s",
        ),
        ("pcap/gs.pcap", "no capture", "mqttxt/attempt-02/pcap/gs.pcap: not a capture: it begins with b'no c'"),
        ("pcap/captures.json", "{}", "mqttxt/attempt-02/pcap/captures.json: expected a list of captures"),
        ("pcap/captures.json", '[{"node": "gs"}]', "mqttxt/attempt-02/pcap/captures.json: expected a list of captures"),
    ],
)
def test_an_attempt_that_cannot_be_read_is_void_and_the_others_are_measured(
    series: Series, file: str, text: str | None, said: str
) -> None:
    path = make_attempt(series, number=2).path / file
    if text is None:
        path.unlink()
    else:
        path.write_text(text)
    side = measure_series(series)["protocols"]["mqttxt"]
    assert [(one["attempt"], one["packets"]) for one in side["attempts"]] == [(1, 7)]
    (void,) = side["void"]
    assert void["attempt"] == 2
    assert void["reason"].startswith(said)
    assert len(void["reason"].splitlines()) == 1


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("nodes", 0, "address"), "10.0.0", "topology: expected nodes with their addresses, and links"),
        (("nodes", 0), {}, "topology: expected nodes with their addresses, and links (KeyError('name'))"),
        (
            ("links", 0, "upper"),
            "mars",
            "topology: link 'wan:gs': expected CLASS:NODE, and both of its ends among the nodes",
        ),
    ],
)
def test_a_manifest_with_another_topology_is_void(
    series: Series, place: tuple[int | str, ...], value: object, said: str
) -> None:
    path = make_attempt(series, number=2).path / "manifest.json"
    changed = read_json(path)
    at = changed["topology"]
    for step in place[:-1]:
        at = at[step]
    at[place[-1]] = value
    write_json(path, changed)
    (void,) = measure_series(series)["protocols"]["mqttxt"]["void"]
    assert void["reason"].startswith(f"mqttxt/attempt-02/manifest.json: {said}")


def test_a_failed_attempt_whose_captures_are_no_captures_stays_failed(series: Series) -> None:
    attempt = make_attempt(series, number=2, status="failed", reason="takeoff: denied", cpu_s={"gs": 1.0})
    (attempt.path / "pcap" / "gs.pcap").write_text("no capture")
    failed = measure_series(series)["protocols"]["mqttxt"]["attempts"][1]
    assert (failed["status"], failed["reason"], failed["packets"]) == ("failed", "takeoff: denied", 0)
    assert failed["notes"] == ["mqttxt/attempt-02/pcap/gs.pcap: not a capture: it begins with b'no c'"]
    assert failed["cpu_s"] == {"gs": 1.0}


def test_a_series_of_which_nothing_can_be_read_is_an_error(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    for number in (1, 2):
        (make_attempt(series, number=number).path / "manifest.json").write_text("{")
    with pytest.raises(ResultsError, match=r"attempt-01/manifest\.json: not JSON"):
        measure_series(series)


def test_a_capture_that_was_cut_off_is_said_beside_the_numbers(series: Series) -> None:
    (series.attempts()[0].path / "pcap" / "uav1.pcap").write_bytes(b"")
    (found,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert (found["packets"], found["truncated"]) == (5, ["uav1.pcap"])
    assert found["notes"] == ["uav1.pcap was cut off; it is counted up to the cut"]
    # whether the drone had the command the captures do not tell: it is not said to be lost
    assert found["messages"]["commands"]["arm"] == {
        **{"sent": 1, "lost": 0, "share": None, "below": None, "open": 1},
        "drones": {"1": {"sent": 1, "lost": 0, "open": 1}},
    }
    assert found["links"]["air:uav1:down"]["lost"] == 0


def test_a_run_that_was_cut_off_between_two_attempts_is_measured_as_far_as_it_went(series: Series) -> None:
    attempt = make_attempt(series, number=2, status="running")
    shutil.rmtree(attempt.path / "pcap")
    (attempt.path / "events.jsonl").write_text('{"t_ns": 1, "event": "sta')
    side = measure_series(series)["protocols"]["mqttxt"]
    assert [one["status"] for one in side["attempts"]] == ["completed"]
    assert side["void"] == [{"attempt": 2, "reason": "the run was cut off"}]


def test_what_differs_between_attempts_is_said(series: Series) -> None:
    assert measure_series(series)["notes"] == []
    make_attempt(
        series,
        number=2,
        revision={"commit": "decade", "dirty": True},
        configuration={"qos": 1, "states": "on-change", "streams": "px4-onboard"},
        host={"kernel": "6.1", "machine": "aarch64"},
    )
    assert measure_series(series)["notes"] == [
        "flown at several revisions: c0ffee in mqttxt 1; decade in mqttxt 2",
        "flown with changes that are in no revision: mqttxt 2",
        "flown on several hosts: kernel 6.1 in mqttxt 2; None in mqttxt 1",
        "flown on several hosts: machine aarch64 in mqttxt 2; x86_64 in mqttxt 1",
        "configured otherwise: qos 0 in mqttxt 1; 1 in mqttxt 2",
    ]


def test_links_that_were_planned_otherwise_under_the_same_name_are_refused(series: Series) -> None:
    second = make_attempt(series, number=2)
    for attempt, loss in ((series.attempts()[0], 0.0), (second, 0.1)):
        (attempt.path / "links").mkdir(exist_ok=True)
        plan = {"profile": "lossy", "seed": attempt.number, "links": {"wan:gs:up": {"loss": loss}}}
        write_json(attempt.path / "links" / "plan.json", {"version": 1, "plan": plan})
    with pytest.raises(ResultsError, match=r"attempt-02: its links were planned otherwise than in the first attempt"):
        measure_series(series)


def test_the_same_results_give_the_same_bytes_wherever_they_lie(series: Series, tmp_path: Path) -> None:
    make_attempt(series, number=2).path.joinpath("manifest.json").write_text("{")
    measure_series(series)
    first = (series.path / "metrics.json").read_bytes()
    elsewhere = tmp_path / "elsewhere" / "of another name"
    shutil.copytree(series.path, elsewhere, ignore=shutil.ignore_patterns("*.parquet", "metrics.json"))
    measure_series(Series(elsewhere))
    assert (elsewhere / "metrics.json").read_bytes() == first
    assert str(tmp_path) not in first.decode()
    measure_series(series)  # with the packets tables made before
    assert (series.path / "metrics.json").read_bytes() == first
    assert json.loads(first)["protocols"]["mqttxt"]["void"][0]["attempt"] == 2


def test_an_empty_capture_beside_whole_ones_takes_nothing_from_them(series: Series) -> None:
    path = series.attempts()[0].path / "pcap" / "stranger.pcap"  # a capture of no node
    write_pcap(path, [(T0 + SECOND, frame("gs", "cloud", b"", 1))])
    (found,) = measure_series(series)["protocols"]["mqttxt"]["attempts"]
    assert found["packets"] == 7
    assert found["notes"] == ["frames from or to addresses of no node are not counted: 1 mqtt"]


def test_an_attempt_that_was_flown_again_stands_beside_the_void_one(series: Series) -> None:
    first = series.attempts()[0].path
    shutil.copytree(first, first.with_name("attempt-01-repeat-1"), ignore=shutil.ignore_patterns("*.parquet"))
    told = json.loads((first / "manifest.json").read_text())
    write_json(first / "manifest.json", told | {"status": "void", "reason": "the links were off"})
    side = measure_series(series)["protocols"]["mqttxt"]
    assert side["void"] == [{"attempt": 1, "reason": "the links were off"}]
    assert [(one["attempt"], one["repeat"], one["packets"]) for one in side["attempts"]] == [(1, 1, 7)]
