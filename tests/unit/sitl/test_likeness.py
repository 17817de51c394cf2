"""The stand-in, flown in simulated time through the cases that real autopilots were recorded in, does the same."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import pytest

from sitl.errors import SitlError
from sitl.likeness import page
from sitl.likeness.agreement import compare
from sitl.likeness.apart import APART, NOT_FLOWN, not_flown, reason
from sitl.likeness.cases import CASES
from sitl.likeness.commands import RECORDINGS, record_into, stand_in, subject
from sitl.likeness.manners import MANNERS
from sitl.likeness.recording import Case, Recording, load
from sitl.likeness.subjects import ArduCopter

pytestmark = pytest.mark.long

RECORDED = {
    like: load(RECORDINGS / f"{name}.json") for like, name in (("px4", "px4-main"), ("ardupilot", "arducopter"))
}
"""By family, the recording that the stand-in is held to."""
FOLDERS = {"px4": "PX4_DIR", "ardupilot": "ARDUPILOT_DIR"}
"""By family, the variable that names a real autopilot's folder."""
PAGE = RECORDINGS.parents[2] / "docs" / "stand-in.md"
APPLYING = [(like, case) for like in MANNERS for case in CASES if not_flown(like, case) is None]


@cache
def _flown_by_the_stand_in(case: str, like: str) -> Recording:
    return stand_in([case], like)


@pytest.mark.parametrize(("like", "case"), APPLYING)
def test_the_stand_in_does_as_a_real_autopilot_was_recorded_to(like: str, case: str) -> None:
    facts = compare(RECORDED[like], _flown_by_the_stand_in(case, like))
    assert len(facts) > 2
    assert [str(fact) for fact in facts if not fact.agrees and reason(like, fact.case, fact.name) is None] == []


@pytest.mark.parametrize("like", RECORDED)
def test_the_pages_tables_are_of_the_recording_and_of_these_flights(like: str, tmp_path: Path) -> None:
    recorded, flown = RECORDED[like], Recording("stand-in")
    for case in recorded.cases:
        flown.add(_flown_by_the_stand_in(case, like))
    for path, marks in ((PAGE, page.APART), (RECORDINGS / "README.md", page.LIKENESS)):
        copy = tmp_path / path.name
        copy.write_text(path.read_text())
        page.write(copy, recorded, flown)
        assert marks[like][0] in copy.read_text()
        assert copy.read_text() == path.read_text(), f"type: .venv/bin/python -m sitl compare --write {path}"


def test_the_page_of_the_mavlink_side_has_the_streams() -> None:
    assert page.streams() in (PAGE.parent / "mavlink.md").read_text()


def test_a_page_without_a_table_is_refused(tmp_path: Path) -> None:
    path, nothing = tmp_path / "page.md", Recording("stand-in")
    path.write_text(page.STREAMS[0])
    with pytest.raises(SitlError, match=r"page\.md: expected <!-- streams"):
        page.write(path, nothing, nothing)
    assert path.read_text() == page.STREAMS[0]


@pytest.mark.parametrize("like", RECORDED)
def test_what_stays_apart_is_in_the_recordings_and_what_does_not_apply_is_in_none(like: str) -> None:
    recording = RECORDED[like]
    known = {(fact.case, fact.name) for fact in compare(recording, recording)}
    assert all(any(case == at and fact.startswith(what) for at, fact in known) for case, what in APART[like])
    assert set(NOT_FLOWN[like]) == set(CASES) - set(recording.cases)


@pytest.mark.parametrize(("name", "like"), [("px4-main", "px4"), ("px4-1.15", "px4"), ("arducopter", "ardupilot")])
def test_recordings_are_of_the_cases_and_small(name: str, like: str, tmp_path: Path) -> None:
    path = RECORDINGS / f"{name}.json"
    recording = load(path)
    assert set(recording.cases) <= set(CASES)
    assert recording.like == like
    assert path.stat().st_size < 80_000
    (tmp_path / "again.json").write_text(recording.text())
    assert load(tmp_path / "again.json") == recording


@pytest.mark.parametrize(("like", "case"), APPLYING)
@pytest.mark.timeout(400)
def test_a_real_autopilot_does_as_it_was_recorded_to(like: str, case: str, tmp_path: Path) -> None:
    """With PX4_DIR, a folder with bin and etc of PX4 main, and ARDUPILOT_DIR; each case has an autopilot of its own."""
    folder, path = os.environ.get(FOLDERS[like]), tmp_path / "again.json"
    if not folder:
        pytest.skip(f"{FOLDERS[like]} names no autopilot with its simulator")
    px4_dir, ardupilot_dir = (Path(folder) if like == one else None for one in ("px4", "ardupilot"))
    record_into(path, subject(px4_dir, ardupilot_dir, instance=240), [case], lambda _: None)
    facts = compare(RECORDED[like], load(path))
    assert [str(fact) for fact in facts if not fact.agrees] == []


@pytest.mark.parametrize("like", MANNERS)
def test_a_page_gets_the_table_of_its_family(like: str, tmp_path: Path) -> None:
    path, (begin, end) = tmp_path / "page.md", page.LIKENESS[like]
    path.write_text(f"{page.STREAMS[0]}{page.STREAMS[1]}\nbefore\n{begin}old{end}\nafter\n")
    flown = stand_in(["disarmed by itself"], like)
    page.write(path, flown, flown)
    before, _, rest = path.read_text().partition(begin)
    assert "before" in before
    table, _, after = rest.partition(end)
    assert after == "\nafter\n"
    row = "| disarmed by itself | results and transitions<br>disarmed, s | 4<br>11 | 4 the same<br>11 |"
    assert row in table
    assert all(f"- {case}: {why}." in page.apart(like, ()) for case, why in NOT_FLOWN[like].items())


def test_a_real_arducopter_is_started_with_a_link_to_its_recorder(tmp_path: Path) -> None:
    for name in ("arducopter", "copter.parm"):
        (tmp_path / name).touch()
    recorded = subject(None, tmp_path, instance=4)
    assert isinstance(recorded, ArduCopter)
    words = recorded.command()
    assert words[0] == str(tmp_path / "arducopter")
    assert words[words.index("--sysid") + 1] == "5" == str(recorded.system)
    assert words[words.index("--serial0") + 1].startswith("udpclient:127.0.0.1:")
    recorded.end()


def _flown(**facts: object) -> Recording:
    return Recording("one", {"case": [Case(**facts)]})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        ({"acks": [("arm", "accepted")]}, {"acks": [("arm", None)]}, "acknowledgement 1, arm: accepted and no answer"),
        ({"durations_s": {"goto": 10.0}}, {"durations_s": {"goto": 11.5}}, "goto, s: 10 and 11.5"),
        ({"durations_s": {"goto": 10.0}}, {}, "goto, s: 10 and -"),
        ({"events": [(1.0, "mode", "hold")]}, {"events": [(1.0, "mode", "land")]}, "mode: hold and land"),
        ({"streams": {"PING": (1.0, 21.0)}}, {"streams": {"PING": (1.3, 21.0)}}, "PING, Hz: 1 and 1.3"),
        ({"numbers": {"north_m": 0.1}}, {"numbers": {"north_m": 0.21}}, "north_m: 0.1 and 0.21"),
        ({"track": [(0, 0, 0, 0), (1, 5, 0, 0)]}, {"track": [(0, 0, 0, 0), (1, 6, 0, 0)]}, "fastest, m/s: 5 and 6"),
    ],
)
def test_what_differs_is_told(first: dict[str, object], second: dict[str, object], told: str) -> None:
    differing = [str(fact) for fact in compare(_flown(**first), _flown(**second)) if not fact.agrees]
    assert f"case: {told}" in differing
    assert all(fact.agrees for fact in compare(_flown(**first), _flown(**first)))


def test_ranges_of_several_flights_have_to_meet() -> None:
    first, second = _flown(durations_s={"goto": 10.0}), _flown(durations_s={"goto": 12.4})
    assert not all(fact.agrees for fact in compare(first, second))
    first.add(_flown(durations_s={"goto": 12.0}))
    assert all(fact.agrees for fact in compare(first, second))


def test_a_file_that_is_no_recording_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text("[]")
    with pytest.raises(SitlError, match=r"x\.json: not a recording"):
        load(path)
    with pytest.raises(SitlError, match="expected bin/px4 in it"):
        subject(tmp_path)
    with pytest.raises(SitlError, match="expected arducopter in it"):
        subject(None, tmp_path)
