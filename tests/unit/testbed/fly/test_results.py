"""The results folder: never overwritten, `latest` always points to something, broken ones are named."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.errors import ResultsError, UserError
from testbed.fly.results import (
    live_attempt,
    new_attempt,
    new_series,
    open_series,
    point_latest,
    read_json,
    read_json_lines,
    write_json,
)


def test_two_series_of_one_second_do_not_share_a_folder(tmp_path: Path) -> None:
    made = [new_series(tmp_path, "scenario-1", "thesis", "ideal").path for _ in range(3)]
    assert len(set(made)) == 3
    assert all(path.parent == tmp_path / "scenario-1" / "thesis-ideal" for path in made)


def test_latest_moves_on(tmp_path: Path) -> None:
    for _ in range(2):
        series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
        new_attempt(series, "mqttxt", 1)
        point_latest(series)
        latest = tmp_path / "scenario-1" / "latest"
        assert latest.is_symlink()
        assert open_series(latest).path == series.path.resolve()


def test_a_fleet_by_hand_has_nothing_of_the_one_before(tmp_path: Path) -> None:
    before = live_attempt(tmp_path / "live", "mqttxt")
    for left in (before.path / "links" / "plan.json", before.key_log):
        left.write_text("of the fleet before")
    attempt = live_attempt(tmp_path / "live", "mqttxt")
    assert not attempt.key_log.exists()
    assert list((attempt.path / "links").iterdir()) == []


def test_a_results_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"results folder .*file"):
        new_series(tmp_path / "file", "scenario-1", "thesis", "ideal")


@pytest.mark.parametrize("profile", ["a:b", "a\nb"])
def test_a_results_folder_that_docker_cannot_mount_is_refused_in_one_line(tmp_path: Path, profile: str) -> None:
    """The name is that of a profile's or a fleet's file."""
    with pytest.raises(UserError, match=r"^results folder '.*thesis-a.*b': expected no ':' and no control character"):
        new_series(tmp_path, "scenario-1", "thesis", profile)
    assert not list(tmp_path.iterdir())


def test_events_are_read_up_to_a_line_that_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text('{"t_ns": 1, "event": "a"}\n{"t_ns": 2, "event": "b"}\n{"t_ns"')
    assert [event["t_ns"] for event in read_json_lines(path)] == [1, 2]
    assert read_json_lines(tmp_path / "none") == []


@pytest.mark.parametrize(("line", "said"), [("{garbage", "not JSON"), ("[1]", "expected an event with t_ns")])
def test_a_line_that_is_no_event_is_named(tmp_path: Path, line: str, said: str) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text('{"t_ns": 1, "event": "a"}\n' + line + "\n")
    with pytest.raises(ResultsError, match=rf"events\.jsonl, line 2: {said}"):
        read_json_lines(path)


def test_what_is_no_attempt_is_passed_over(tmp_path: Path) -> None:
    series = new_series(tmp_path, "scenario-1", "thesis", "ideal")
    new_attempt(series, "mqttxt", 1)
    (series.path / "mqttxt" / "attempt-x").mkdir()
    (series.path / "mqttxt" / "attempt-02").touch()
    assert [attempt.number for attempt in series.attempts()] == [1]


def test_two_that_write_a_file_at_once_leave_a_whole_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As two reports of one series."""
    path, replace, written = tmp_path / "metrics.json", Path.replace, list[str]()

    def replaced(self: Path, target: Path) -> Path:
        if not written:
            written.append("by the other")
            write_json(path, {"by": "the other"})
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", replaced)
    write_json(path, {"by": "this one"})
    assert read_json(path) == {"by": "this one"}
    assert [one.name for one in tmp_path.iterdir()] == ["metrics.json"]


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"gone/a\.json"):
        write_json(tmp_path / "gone" / "a.json", {})
